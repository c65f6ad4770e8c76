// Pictures of the page: docs/page.png for the README, and into www/test-results those to look at after a change of style.

import { mkdir } from "node:fs/promises";
import { join } from "node:path";
import { launch, openPage, ROOT, servePage, tableDone, WWW } from "./support.js";

/** @typedef {import("playwright-core").Page} Page */

const RESULTS = join(WWW, "test-results");
const MATRIX = "#planners=random,dc05v,tk22,lipids,oracle&solvers=ls,trimmed,sbr,pixel,context&lights=10&draws=3";

const server = await servePage();
const browser = await launch();
await mkdir(RESULTS, { recursive: true });

/**
 * @param {string} file
 * @param {import("playwright-core").BrowserContextOptions} options
 * @param {{ hash?: string, fullPage?: boolean, before?: (page: Page) => Promise<unknown> }} [more]
 */
async function take(file, options, { hash = "", fullPage = true, before } = {}) {
  const { page, context } = await openPage(browser, options);
  await page.goto(server.url + hash);
  await tableDone(page, 180_000);
  await before?.(page);
  await page.waitForTimeout(500); // the last frames after the table
  await page.screenshot({ path: file, fullPage });
  await context.close();
}

/** @type {Record<string, { hash?: string, fullPage?: boolean, before?: (page: Page) => Promise<unknown> }>} */
const STATES = {
  first: {},
  matrix: {
    hash: MATRIX,
    async before(page) {
      await page.getByLabel("Solver shown").selectOption("context");
      await page.getByRole("button", { name: "Show in 3-D" }).click();
      await page.waitForFunction(() => document.querySelector("#chart .note")?.textContent?.startsWith("First draw"), null, { timeout: 120_000 });
      await page.waitForFunction(() => document.querySelector(".map-surface canvas")?.getAttribute("width") === "360", null, { timeout: 60_000 });
    },
  },
  problem: {
    async before(page) {
      await page.setInputFiles("#object .file-input", { name: "broken.zip", mimeType: "application/zip", buffer: Buffer.from("not a zip") });
      await page.locator("#problems .problem").waitFor();
    },
  },
  hover: {
    fullPage: false,
    async before(page) {
      await page.locator("#dome").scrollIntoViewIfNeeded();
      await page.locator(".dome [data-candidate='60']").hover({ force: true });
      await page.locator(".dome-tip").waitFor();
    },
  },
  early: { before: page => page.locator("#scrub").fill("2") },
  dialog: { fullPage: false, before: page => page.getByRole("button", { name: "Render an object…" }).click() },
  rig: { before: page => page.getByRole("tab", { name: "Rig" }).click().then(() => page.locator(".rig-bar").waitFor()) },
};

const wanted = process.argv.slice(2); // parts of names; none: all
if (!wanted.length || wanted.includes("docs")) await take(join(ROOT, "docs/page.png"), { viewport: { width: 1440, height: 1160 }, deviceScaleFactor: 0.8 }, {
  fullPage: false,
  async before(page) {
    await page.getByRole("button", { name: "Show in 3-D" }).click();
    await page.waitForFunction(() => document.querySelector(".map-surface canvas")?.getAttribute("width") === "360", null, { timeout: 60_000 });
  },
});
for (const [name, state] of Object.entries(STATES)) {
  for (const width of [1440, 390]) {
    for (const colorScheme of /** @type {const} */ (["light", "dark"])) {
      const file = `${name}-${width}-${colorScheme}`;
      if (wanted.length && !wanted.some(part => file.includes(part))) continue;
      await take(join(RESULTS, `${file}.png`), { viewport: { width, height: 900 }, colorScheme }, state);
    }
  }
}
await browser.close();
server.close();
