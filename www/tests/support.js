// What every browser test needs: the page on loopback, a Chromium, and the rules for shared data.

import { spawnSync } from "node:child_process";
import { existsSync } from "node:fs";
import { readFile, stat } from "node:fs/promises";
import { createServer } from "node:http";
import { extname, join, normalize } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

export const WWW = fileURLToPath(new URL("..", import.meta.url));
export const ROOT = join(WWW, "..");
export const TARGET = process.env.CARGO_TARGET_DIR ?? join(ROOT, "target");
/** Searched in turn, as `coil serve` does. */
const SERVED = [WWW, join(TARGET, "page")];
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".wasm": "application/wasm", ".svg": "image/svg+xml", ".woff2": "font/woff2", ".json": "application/json" };

/** The page at a port of its own. @returns {Promise<{ url: string, close: () => void }>} */
export async function servePage() {
  if (!existsSync(join(SERVED[1], "pkg/core/coil_ps_bg.wasm"))) {
    throw new Error(`no module in ${SERVED[1]}: run coil serve --build-only first`);
  }
  const policy = existsSync(join(SERVED[1], "pkg/policy/coil_ps_bg.wasm")) && existsSync(join(ROOT, "models/compact/step.onnx"));
  const status = { modules: { core: { state: "ready" }, policy: { state: policy ? "ready" : "failed", message: "not built" } } };
  const server = createServer(async (request, response) => {
    if (request.url?.startsWith("/build-status.json")) return void response.writeHead(200, { "Content-Type": "application/json" }).end(JSON.stringify(status));
    if (request.url === "/models/index.json") return void response.writeHead(200, { "Content-Type": "application/json" }).end('{"models":["compact","compact-limited"]}');
    const path = normalize(decodeURIComponent(new URL(request.url ?? "/", "http://localhost").pathname)).replace(/\/$/, "/index.html");
    for (const folder of path.startsWith("/models/") ? [ROOT] : SERVED) {
      const file = join(folder, path);
      if (!(await stat(file).catch(() => null))?.isFile()) continue;
      const type = TYPES[/** @type {keyof typeof TYPES} */ (extname(file))] ?? "application/octet-stream";
      response.writeHead(200, { "Content-Type": type, "Cache-Control": "no-store", "Cross-Origin-Opener-Policy": "same-origin", "Cross-Origin-Embedder-Policy": "require-corp" });
      response.end(await readFile(file));
      return;
    }
    response.writeHead(404).end("no such file");
  });
  await new Promise(resolve => server.listen(0, "127.0.0.1", () => resolve(null)));
  const address = server.address();
  if (!address || typeof address === "string") throw new Error("the server has no port");
  return { url: `http://127.0.0.1:${address.port}/`, close: () => server.close() };
}

/** @param {string[]} [more] switches of Chromium @returns {Promise<import("playwright-core").Browser>} */
export function launch(more = []) {
  const names = [process.env.CHROMIUM, "chromium", "chromium-browser", "google-chrome"];
  const executablePath = names.flatMap(name => name ? spawnSync("which", [name], { encoding: "utf8" }).stdout.trim() : [])
    .find(path => path);
  if (!executablePath) throw new Error("no Chromium: install one (setup/browser.sh) or name it in CHROMIUM");
  const args = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync", ...more];
  return chromium.launch({ executablePath, args });
}

/**
 * A page whose every console error and exception is collected.
 * @param {import("playwright-core").Browser} browser
 * @param {import("playwright-core").BrowserContextOptions} [options]
 */
export async function openPage(browser, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, ...options });
  const page = await context.newPage();
  /** @type {string[]} */
  const complaints = [];
  page.on("console", message => { if (["error", "warning"].includes(message.type())) complaints.push(message.text()); });
  page.on("pageerror", error => complaints.push(String(error)));
  return { page, context, complaints };
}

/**
 * Waits until a run has ended with a table.
 * @param {import("playwright-core").Page} page
 */
export async function tableDone(page, timeout = 60_000) {
  const done = () => document.querySelector("#results tbody tr") && document.querySelector("#settings .progress[hidden]")
    && document.querySelector("#object .progress[hidden]");
  await page.waitForFunction(done, null, { timeout });
}

/**
 * Where the shared data lies. Without it the test says that it is skipped; in CI that is a failure.
 * @param {import("node:test").TestContext} t
 * @returns {string | null}
 */
export function sharedData(t) {
  const places = [process.env.COIL_DATA, join(ROOT, "../shared/data")];
  const found = places.find(place => place && existsSync(join(place, "DiLiGenT")));
  if (found) return found;
  if (process.env.CI) throw new Error("the shared data is missing: set COIL_DATA");
  t.skip("no shared data: set COIL_DATA");
  return null;
}

/** The command line, in a build that is there. */
export function COIL() {
  const places = [process.env.COIL, join(TARGET, "release/coil"), join(TARGET, "debug/coil")];
  const found = places.find(place => place && existsSync(place));
  if (!found) throw new Error("no command line: run cargo build --bin coil, or name it in COIL");
  return found;
}
