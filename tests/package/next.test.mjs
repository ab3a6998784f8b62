// The lines for Next on the package's page, without configuration for the package: built as static files, and a picture located.
import assert from "node:assert/strict";
import { cp, mkdir, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { test } from "node:test";
import { browser, open, serve } from "./page.mjs";
import { snippet } from "./snippets.mjs";
import { installed, npm, run } from "./support.mjs";

// Nothing is told to anybody.
process.env.NEXT_TELEMETRY_DISABLED = "1";

test("a Next project locates the sample", { timeout: 900_000 }, async (t) => {
  const folder = await installed(t);
  const added = await run(npm, ["install", "--no-audit", "--no-fund", "next@16.4.6", "react@19.2.0", "react-dom@19.2.0"], folder);
  assert.equal(added.status, 0, added.stderr);
  for (const name of ["app", "public"]) await mkdir(join(folder, name));
  await cp(join(folder, "node_modules/landline/sample/sample.landline"), join(folder, "public/room.landline"));
  await writeFile(join(folder, "next.config.mjs"), 'export default { output: "export" };\n');
  await writeFile(join(folder, "app/open.js"), await snippet("pkg-config/README.npm.md", '"use client"'));
  await writeFile(join(folder, "app/layout.jsx"), 'export default function Layout({ children }) { return <html lang="en"><head><link rel="icon" href="data:," /></head><body>{children}</body></html>; }\n');
  await writeFile(
    join(folder, "app/page.jsx"),
    `"use client";
import { intrinsics, picture } from "landline/sample";
import { useEffect } from "react";
import { open } from "./open.js";
async function locate() {
  const relocalizer = await open();
  const result = await relocalizer.locate(await (await fetch(picture)).blob(), { intrinsics });
  return result.located;
}
export default function Page() {
  useEffect(() => void locate().then((located) => (globalThis.outcome = located), (error) => (globalThis.outcome = String(error))), []);
  return null;
}
`,
  );
  const built = await run(npm, ["exec", "--", "next", "build"], folder);
  assert.equal(built.status, 0, built.stderr + built.stdout);
  const server = await serve(t, { dir: join(folder, "out") });
  const { page, said } = await open(await browser(t), server.url);
  await page.waitForFunction(() => globalThis.outcome !== undefined).catch((error) => assert.fail(`${error} ${said}`));
  assert.equal(await page.evaluate(() => globalThis.outcome), true);
  assert.deepEqual(said, []);
});
