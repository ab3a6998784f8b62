// The packed package in a webpack project without configuration: built, served, and the sample located.
import assert from "node:assert/strict";
import { mkdir, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { test } from "node:test";
import { browser, open, serve } from "./page.mjs";
import { snippet } from "./snippets.mjs";
import { installed, npm, run } from "./support.mjs";

test("a webpack project locates the sample", { timeout: 600_000 }, async (t) => {
  const folder = await installed(t);
  const added = await run(npm, ["install", "--no-audit", "--no-fund", "--save-dev", "webpack@5.113.0", "webpack-cli@6.0.1"], folder);
  assert.equal(added.status, 0, added.stderr);
  await mkdir(join(folder, "src"));
  const code = await snippet("pkg-config/README.npm.md", "await fetch(picture)");
  await writeFile(join(folder, "src/index.js"), `${code}\nglobalThis.outcome = result.located ? result.placement.position : result.reason;\n`);
  const built = await run(npm, ["exec", "--", "webpack", "--mode", "production"], folder);
  assert.equal(built.status, 0, built.stderr + built.stdout);
  await writeFile(join(folder, "dist/index.html"), '<!doctype html><meta charset="utf-8"><title>t</title><link rel="icon" href="data:,"><script type="module" src="./main.js"></script>');
  const server = await serve(t, { dir: join(folder, "dist"), base: "/my-app/" });
  const { page, said } = await open(await browser(t), server.url);
  await page.waitForFunction(() => globalThis.outcome !== undefined).catch((error) => assert.fail(`${error} ${said}`));
  const { x, y, z } = await page.evaluate(() => globalThis.outcome);
  assert.ok(Math.hypot(x - 4.3485, y - 2.4862, z - 1.7009) < 0.05, `${x} ${y} ${z}`);
  assert.deepEqual(said, []);
  assert.equal(server.requests.filter(({ path }) => /[0-9a-f]{8,}\.wasm$/.test(path)).length, 1, "one build of the engine came from the bundle");
});
