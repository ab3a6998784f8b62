// The lines for React and Vue on the package's page, in one Vite project: a relocalizer a mounted component, and none after it.
import assert from "node:assert/strict";
import { mkdir, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { test } from "node:test";
import { browser, open, serve } from "./page.mjs";
import { snippet } from "./snippets.mjs";
import { installed, npm, run } from "./support.mjs";

const npmReadme = "pkg-config/README.npm.md";

test("React mounts twice and leaves nothing behind; Vue holds a relocalizer", { timeout: 600_000 }, async (t) => {
  const folder = await installed(t);
  const added = await run(npm, ["install", "--no-audit", "--no-fund", "--save-dev", "vite@8.3.8", "react@19.2.0", "react-dom@19.2.0", "vue@3.5.22"], folder);
  assert.equal(added.status, 0, added.stderr);
  await mkdir(join(folder, "public"));
  const page = (script) => `<!doctype html><meta charset="utf-8"><title>t</title><link rel="icon" href="data:,"><div id="root"></div><script type="module" src="/${script}"></script>`;
  await writeFile(join(folder, "index.html"), page("react.js"));
  await writeFile(join(folder, "vue.html"), page("vue.js"));
  const config = (await snippet(npmReadme, "// vite.config.js")).replace("{ optimizeDeps", '{ build: { rollupOptions: { input: ["index.html", "vue.html"] } }, optimizeDeps');
  await writeFile(join(folder, "vite.config.js"), config);
  await writeFile(
    join(folder, "react.js"),
    `import { Relocalizer } from "landline";
import { scene } from "landline/sample";
import { StrictMode, createElement, useEffect } from "react";
import { createRoot } from "react-dom/client";
const { create } = Relocalizer;
globalThis.made = 0;
globalThis.disposed = 0;
Relocalizer.create = async (options) => {
  const relocalizer = await create(options);
  globalThis.made += 1;
  const { dispose } = relocalizer;
  relocalizer.dispose = () => ((globalThis.disposed += 1), dispose.call(relocalizer));
  return relocalizer;
};
function Room() {
  ${await snippet(npmReadme, "useEffect(")}
  return null;
}
const root = createRoot(document.getElementById("root"));
root.render(createElement(StrictMode, undefined, createElement(Room)));
globalThis.unmount = () => root.unmount();
`,
  );
  const vue = await snippet(npmReadme, "shallowRef");
  await writeFile(
    join(folder, "vue.js"),
    `import { Relocalizer } from "landline";
import { intrinsics, picture, scene } from "landline/sample";
const video = await (await fetch(picture)).blob();
${vue.replace("locate(video)", "locate(video, { intrinsics })")}
globalThis.outcome = located.located;
`,
  );
  // Only in development does React mount twice.
  await writeFile(join(folder, ".env"), "NODE_ENV=development\n");
  const built = await run(npm, ["exec", "--", "vite", "build", "--mode", "development"], folder);
  assert.equal(built.status, 0, built.stderr + built.stdout);
  const server = await serve(t, { dir: join(folder, "dist") });
  const launched = await browser(t);
  const react = await open(launched, server.url);
  await react.page.waitForFunction(() => globalThis.made === 2 && globalThis.disposed === 1);
  await react.page.evaluate(() => globalThis.unmount());
  await react.page.waitForFunction(() => globalThis.disposed === 2);
  while (react.page.workers().length > 0) await react.page.waitForTimeout(50);
  const held = await open(launched, `${server.url}vue.html`);
  await held.page.waitForFunction(() => globalThis.outcome !== undefined).catch((error) => assert.fail(`${error} ${held.said}`));
  assert.equal(await held.page.evaluate(() => globalThis.outcome), true);
  assert.deepEqual([...react.said, ...held.said], []);
});
