// Pictures of the page: docs/page.png for the README, and into www/test-results those to look at after a change of style.

import { mkdir } from "node:fs/promises";
import { join } from "node:path";
import { launch, openPage, ROOT, servePage, tableDone, WWW } from "./support.js";

const server = await servePage();
const browser = await launch();

/**
 * @param {string} file
 * @param {import("playwright-core").BrowserContextOptions} options
 * @param {boolean} fullPage
 */
async function take(file, options, fullPage) {
  const { page, context } = await openPage(browser, options);
  await page.goto(server.url);
  await tableDone(page, 120_000);
  await page.waitForTimeout(500); // the last frames after the table
  await page.screenshot({ path: file, fullPage });
  await context.close();
}

await take(join(ROOT, "docs/page.png"), { viewport: { width: 1440, height: 985 }, deviceScaleFactor: 0.8 }, false);
const results = join(WWW, "test-results");
await mkdir(results, { recursive: true });
for (const width of [1440, 768, 360]) {
  for (const colorScheme of /** @type {const} */ (["light", "dark"])) {
    await take(join(results, `${width}-${colorScheme}.png`), { viewport: { width, height: 900 }, colorScheme }, true);
  }
}
await browser.close();
server.close();
