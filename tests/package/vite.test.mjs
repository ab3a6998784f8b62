// The packed package in a new Vite project: built, served, and one picture located.
import assert from "node:assert/strict";
import { cp, mkdir, readFile, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { test } from "node:test";
import { browser, haveSample, open, serve } from "./page.mjs";
import { snippet } from "./snippets.mjs";
import { installed, npm, run, site } from "./support.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";

test("a Vite project locates a picture", { skip, timeout: 600_000 }, async (t) => {
  const folder = await installed(t);
  const added = await run(npm, ["install", "--no-audit", "--no-fund", "--save-dev", "vite@8.3.8"], folder);
  assert.equal(added.status, 0, added.stderr);
  const sample = join(site(), "scenes/sample");
  const { pictures, camera } = JSON.parse(await readFile(join(sample, "sample.json"), "utf8"));
  await mkdir(join(folder, "public"));
  await cp(join(sample, "sample.landline"), join(folder, "public/room.landline"));
  await cp(join(sample, pictures[0].name), join(folder, "public/picture.jpg"));
  await writeFile(join(folder, "index.html"), '<!doctype html><meta charset="utf-8"><title>t</title><link rel="icon" href="data:,"><script type="module" src="/main.js"></script>');
  await writeFile(join(folder, "vite.config.js"), await snippet("pkg-config/README.npm.md", "// vite.config.js"));
  await writeFile(
    join(folder, "main.js"),
    `import { Relocalizer } from "landline";
try {
  const relocalizer = await Relocalizer.create({ scene: "/room.landline" });
  const blob = await (await fetch("/picture.jpg")).blob();
  const result = await relocalizer.locate(blob, { intrinsics: ${JSON.stringify(camera)} });
  globalThis.outcome = { located: result.located, reason: result.reason, position: result.placement?.position };
} catch (error) {
  globalThis.outcome = { error: \`\${error.code}: \${error.message}\` };
}
`,
  );
  const built = await run(npm, ["exec", "--", "vite", "build"], folder);
  assert.equal(built.status, 0, built.stderr + built.stdout);
  const server = await serve(t, { dir: join(folder, "dist") });
  const { page, said } = await open(await browser(t), server.url);
  await page.waitForFunction(() => globalThis.outcome !== undefined);
  const outcome = await page.evaluate(() => globalThis.outcome);
  assert.equal(outcome.located, true, JSON.stringify(outcome));
  assert.deepEqual(said, []);
  const engines = server.requests.filter(({ path }) => /landline(_relaxed)?_bg.*\.wasm$/.test(path)).map(({ path }) => path);
  assert.equal(new Set(engines).size, 1, `one build of the engine came from the bundle: ${engines}`);
});
