// What the scripts of this folder share: the packed package in an empty folder, and the tools of web/package-lock.json.
import { execFile } from "node:child_process";
import { mkdtemp, rm, writeFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { promisify } from "node:util";

export const root = fileURLToPath(new URL("../../", import.meta.url));

/** A package of web/node_modules, by name. */
export const tools = createRequire(join(root, "web/package.json"));

const given = (name) => {
  const value = process.env[name];
  if (!value) throw new Error(`${name} is not set: run these tests with \`cargo xtask test --only package\``);
  return value;
};

export const tarball = () => given("LANDLINE_TARBALL");
export const chrome = () => given("CHROME");
export const site = () => given("LANDLINE_SITE");

export const npm = process.platform === "win32" ? "npm.cmd" : "npm";

const execute = promisify(execFile);

/** Runs a program; resolves to its output and exit status, whatever that is. */
export async function run(program, args, cwd) {
  try {
    const { stdout, stderr } = await execute(program, args, { cwd, maxBuffer: 1 << 26 });
    return { status: 0, stdout, stderr };
  } catch (error) {
    if (typeof error.code !== "number") throw error;
    return { status: error.code, stdout: error.stdout, stderr: error.stderr };
  }
}

/** Installs the tarball in a new empty folder, as a stranger would, and removes the folder when the test ends. */
export async function installed(test) {
  const folder = await mkdtemp(join(tmpdir(), "landline-package-"));
  test.after(() => rm(folder, { recursive: true, force: true }));
  await writeFile(join(folder, "package.json"), JSON.stringify({ private: true, type: "module" }));
  // Offline: the package depends on nothing, and must keep to that.
  const result = await run(npm, ["install", "--offline", "--no-audit", "--no-fund", tarball()], folder);
  if (result.status !== 0) throw new Error(`npm install failed:\n${result.stderr}`);
  return folder;
}
