// The code in every README and guide, taken from the file: all of it type-checks against the packed package, and what stands by
// itself runs.
import assert from "node:assert/strict";
import { cp, readFile, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { test } from "node:test";
import { browser, fakeCamera, open, serve } from "./page.mjs";
import { documents, snippet, snippets } from "./snippets.mjs";
import { installed, npm, root, run } from "./support.mjs";

const npmReadme = "pkg-config/README.npm.md";

/** What a reader has by then: from the snippet before, or of his own page. Only names that a snippet does not make itself. */
const brought = {
  Relocalizer: 'import { Relocalizer } from "landline";',
  relocalizer: 'declare const relocalizer: import("landline").Relocalizer;',
  mapper: 'declare const mapper: import("landline/mapper").Mapper;',
  scene: "declare const scene: string;",
  video: "declare const video: HTMLVideoElement;",
  cdn: "declare const cdn: string;",
  fileInput: "declare const fileInput: HTMLInputElement;",
  useEffect: "declare function useEffect(effect: () => void | (() => void), on: unknown[]): void;",
};

/** Packages that a snippet uses and that are not ours. */
const foreign = ["jpeg-js", "vue"];

/** The scripts of a snippet. */
function scripts({ language, code }) {
  if (["js", "ts", "jsx", "mjs"].includes(language)) return [code];
  if (language === "html") return [...code.matchAll(/<script type="module">([\s\S]*?)<\/script>/g)].map(([, script]) => script);
  return [];
}

test("code in the documents type-checks as it is printed", async (t) => {
  const folder = await installed(t);
  const files = [];
  for (const document of await documents()) {
    for (const one of await snippets(document)) {
      for (const script of scripts(one)) {
        const name = `${document.replaceAll(/\W/g, "_")}_${files.length}.ts`;
        const makes = (word) => new RegExp(`(const|let|function|class) (\\{[^}]*)?\\b${word}\\b|import [^;]*\\b${word}\\b[^;]* from`).test(script);
        const prelude = Object.entries(brought).filter(([word]) => new RegExp(`\\b${word}\\b`).test(script) && !makes(word));
        await writeFile(join(folder, name), `${prelude.map(([, line]) => line).join(" ")}\n${script}\nexport {};\n`);
        files.push(name);
      }
    }
  }
  assert.ok(files.length >= 10, `${files.length} snippets`);
  await writeFile(join(folder, "foreign.d.ts"), `${foreign.map((name) => `declare module "${name}";`).join("\n")}\ndeclare module "node:fs/promises" { export function readFile(path: string | URL): Promise<Uint8Array>; }\n`);
  const options = {
    module: "esnext", moduleResolution: "bundler", target: "es2022", lib: ["es2023", "esnext.disposable", "dom", "dom.asynciterable"],
    // They are JavaScript: a parameter without a type is no fault.
    strict: true, noImplicitAny: false, noEmit: true, types: [], jsx: "preserve",
  };
  await writeFile(join(folder, "tsconfig.json"), JSON.stringify({ compilerOptions: options, files: ["foreign.d.ts", ...files] }));
  const check = () => run(process.execPath, [join(root, "web/node_modules/typescript/bin/tsc"), "--project", "tsconfig.json"], folder);
  const { status, stdout } = await check();
  assert.equal(status, 0, stdout);

  // A misspelt name is noticed.
  const first = join(folder, files.find((name) => name.includes("npm")));
  await writeFile(first, (await readFile(first, "utf8")).replace("placement", "plaecment"));
  assert.match((await check()).stdout, /plaecment/);
});

/** The import map as the package's page prints it. */
async function printedImports() {
  const html = await snippet(npmReadme, 'type="importmap"');
  return JSON.parse(/<script type="importmap">(.*?)<\/script>/s.exec(html)[1]).imports;
}

test("the first lines of the package's page locate its sample", { timeout: 240_000 }, async (t) => {
  const folder = await installed(t);
  const code = await snippet(npmReadme, "await fetch(picture)");
  const imports = await printedImports();
  const html = `<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,"><script type="importmap">${JSON.stringify({ imports })}</script>
    <script type="module">${code}
    import { position as truth } from "landline/sample";
    const at = result.located ? result.placement.position : undefined;
    globalThis.outcome = at ? Math.hypot(at.x - truth.x, at.y - truth.y, at.z - truth.z) : result.reason;</script>`;
  await writeFile(join(folder, "index.html"), html);
  const server = await serve(t, { dir: folder });
  const { page, said } = await open(await browser(t), server.url);
  await page.waitForFunction(() => globalThis.outcome !== undefined);
  const off = await page.evaluate(() => globalThis.outcome);
  assert.ok(off < 0.05, `${off} ${said}`);
  assert.deepEqual(said, []);
  assert.ok(server.requests.some(({ path }) => path.endsWith("sample/picture.jpg")));
});

test("the page of the repository's README locates the sample", { timeout: 240_000 }, async (t) => {
  const folder = await installed(t);
  const page = await snippet("README.md", "<!doctype html>");
  await writeFile(join(folder, "index.html"), page.replace("<!doctype html>", '<!doctype html><link rel="icon" href="data:,">'));
  const server = await serve(t, { dir: folder });
  const { page: opened, said } = await open(await browser(t), server.url);
  await opened.waitForFunction(() => /taken at|not located/.test(document.body.textContent));
  const at = (await opened.textContent("body")).match(/taken at ([\d., -]+)/)?.[1].split(", ").map(Number);
  const truth = [4.3485, 2.4862, 1.7009]; // of landline/sample
  assert.ok(at && Math.hypot(...truth.map((value, axis) => value - at[axis])) < 0.05, `${at} ${said}`);
  assert.deepEqual(said, []);
});

test("the lines for Node locate the sample", { timeout: 240_000 }, async (t) => {
  const folder = await installed(t);
  const added = await run(npm, ["install", "--no-audit", "--no-fund", "jpeg-js@0.4.4"], folder);
  assert.equal(added.status, 0, added.stderr);
  const code = await snippet(npmReadme, "// locate.mjs");
  await writeFile(join(folder, "locate.mjs"), `${code}
    import { position as truth } from "landline/sample";
    const at = result.located ? result.placement.position : undefined;
    if (!at || Math.hypot(at.x - truth.x, at.y - truth.y, at.z - truth.z) > 0.05) process.exitCode = 1;`);
  const { status, stdout, stderr } = await run(process.execPath, ["locate.mjs"], folder);
  assert.equal(status, 0, stdout + stderr);
  assert.match(stdout, /x: 4\.3/);
});

test("the lines for a camera follow it, and stop", { timeout: 240_000 }, async (t) => {
  const folder = await installed(t);
  const code = await snippet(npmReadme, "button.onclick = start");
  const imports = await printedImports();
  await writeFile(join(folder, "index.html"), `<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,"><body><script type="importmap">${JSON.stringify({ imports })}</script><script type="module">${code}</script>`);
  const server = await serve(t, { dir: folder });
  const flags = await fakeCamera(t, [join(folder, "node_modules/landline/sample/picture.jpg")], 60);
  const { page, said } = await open(await browser(t, flags), server.url, { permissions: ["camera"] });
  const logged = [];
  page.on("console", (message) => logged.push(message.text()));
  await page.click("text=Start");
  for (let i = 0; i < 600 && !logged.some((text) => /^(tracking|localization) [\d.]+ /.test(text)); i++) await page.waitForTimeout(100);
  assert.ok(logged.some((text) => /^(tracking|localization) [\d.]+ /.test(text)), logged.join("\n"));
  assert.ok(await page.evaluate(() => document.querySelector("canvas").getContext("2d").getImageData(200, 200, 1, 1).data[3] === 255), "the picture is drawn");
  await page.click("text=Stop");
  assert.deepEqual(said, []);
});

test("plain HTML and a CDN work as the package's page says", { timeout: 240_000 }, async (t) => {
  const folder = await installed(t);
  await writeFile(join(folder, "plain.html"), `<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">${await snippet(npmReadme, 'type="importmap"')}`);
  const code = await snippet(npmReadme, "createObjectURL");
  const other = await serve(t, { dir: join(folder, "node_modules/landline"), headers: { "access-control-allow-origin": "*" } });
  const script = `const cdn = ${JSON.stringify(other.url.replace(/\/$/, ""))}; const scene = "./room.landline";\n${code}\nglobalThis.outcome = relocalizer.scene.extractor ?? "made"; await relocalizer.dispose();`;
  await writeFile(join(folder, "cdn.html"), `<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,"><script type="module">${script}</script>`);
  await cp(join(folder, "node_modules/landline/sample/sample.landline"), join(folder, "room.landline"));
  const server = await serve(t, { dir: folder });
  const launched = await browser(t);
  const plain = await open(launched, `${server.url}plain.html`);
  await plain.page.waitForFunction(() => document.title !== "");
  assert.equal(await plain.page.title(), "ready");
  const { page, said } = await open(launched, `${server.url}cdn.html`);
  await page.waitForFunction(() => globalThis.outcome !== undefined).catch((error) => assert.fail(`${error} ${said}`));
  assert.deepEqual([...plain.said, ...said], []);
  assert.ok(other.requests.some(({ path }) => path.endsWith("worker.js")), "the worker came from there");
});
