// The rig view in Chromium: a Web Serial stand-in at `navigator.serial`, behind it the simulated Grbl of the core.

import assert from "node:assert/strict";
import { after, before } from "node:test";
import { launch, openPage, servePage } from "./support.js";

/** @type {Awaited<ReturnType<typeof servePage>>} */
export let site;
/** @type {import("playwright-core").Browser} */
let browser;
before(async () => { site = await servePage(); browser = await launch(); });
after(async () => { await browser?.close(); site?.close(); });

/** Puts a serial API in place whose one port is the simulated board. Runs in the page before it loads. */
function standIn() {
  /** @type {any} */
  const w = window;
  w.rigTest = { kind: "guide", answer: "board", remembered: false, gone: false };
  /** @type {any} */
  let port = null;
  const made = async () => {
    if (port) return port;
    const { default: init } = await import(new URL("pkg/core/coil_ps.js", document.baseURI).href);
    await init({ module_or_path: new URL("pkg/core/coil_ps_bg.wasm", document.baseURI) });
    const { SimulatedPort } = await import(new URL("rig/simulated.js", document.baseURI).href);
    port = new SimulatedPort(w.rigTest.kind);
    w.rigTest.port = port;
    const open = port.open.bind(port);
    port.open = async (/** @type {any} */ options) => {
      if (w.rigTest.gone) throw new DOMException("Failed to open serial port.", "NotFoundError");
      if (w.rigTest.answer === "busy") throw new DOMException("Failed to open serial port.", "NetworkError");
      if (options.baudRate !== 115200) throw new TypeError("baud rate");
      return open();
    };
    port.getInfo = () => ({ usbVendorId: 0x2341, usbProductId: 0x0043 });
    return port;
  };
  Object.defineProperty(navigator, "serial", {
    configurable: true,
    value: {
      async getPorts() { return w.rigTest.remembered ? [await made()] : []; },
      async requestPort() {
        if (w.rigTest.answer === "deny") throw new DOMException("No port selected by the user.", "NotFoundError");
        w.rigTest.remembered = true;
        return made();
      },
      addEventListener() {},
    },
  });
}

/** The same port once more, in the worker that serves ports. @param {string} base */
export async function standInWorker(base) {
  const { default: init } = await import(new URL("pkg/core/coil_ps.js", base).href);
  await init({ module_or_path: new URL("pkg/core/coil_ps_bg.wasm", base) });
  const { SimulatedPort } = await import(new URL("rig/simulated.js", base).href);
  const port = new SimulatedPort("guide");
  port.getInfo = () => ({ usbVendorId: 0x2341, usbProductId: 0x0043 });
  /** @type {any} */ (self).rigTest = { port };
  Object.defineProperty(navigator, "serial", { configurable: true, value: { getPorts: async () => [port] } });
}

/**
 * @param {(page: import("playwright-core").Page) => Promise<void>} body
 * @param {boolean} [serial] with the stand-in; without, the page's own simulated arm is four times as fast as a real one
 * @param {import("playwright-core").Browser} [within]
 */
export async function withRig(body, serial = true, within = browser) {
  const { page, context, complaints } = await openPage(within);
  try {
    if (serial) await page.addInitScript(standIn);
    await page.goto(serial ? site.url : `${site.url}?pace=4`);
    await page.getByRole("tab", { name: "Rig" }).click();
    await page.locator(".rig-planner option").first().waitFor({ state: "attached" });
    await page.evaluate(recordStates);
    await body(page);
    assert.deepEqual(complaints.filter(c => !/Failed to load resource/.test(c)), []);
  } finally {
    await context.close();
  }
}

/** @param {import("playwright-core").Page} page @param {string} choice */
export async function connect(page, choice) {
  await page.locator(".rig-port").selectOption(choice);
  await page.getByRole("button", { name: "Connect", exact: true }).click();
}

/** @param {import("playwright-core").Page} page @param {RegExp} text */
export const state = (page, text, timeout = 20_000) => page.waitForFunction(
  source => new RegExp(source).test(document.querySelector(".rig-state")?.textContent ?? ""), text.source, { timeout });

/** Keeps every text of the connection's state: some last only a moment, which a busy machine may not be asked in. */
function recordStates() {
  const element = /** @type {Element} */ (document.querySelector(".rig-state"));
  /** @type {string[]} */
  const states = /** @type {any} */ (window).rigStates = [element.textContent];
  new MutationObserver(() => states.push(element.textContent ?? "")).observe(element, { childList: true, characterData: true, subtree: true });
}

/** Waits until the connection's state was like each of these, in this order. @param {import("playwright-core").Page} page @param {...RegExp} texts */
export const passed = (page, ...texts) => page.waitForFunction(sources => {
  let at = 0;
  for (const state of /** @type {any} */ (window).rigStates ?? []) if (at < sources.length && new RegExp(sources[at]).test(state)) at += 1;
  return at === sources.length;
}, texts.map(text => text.source), { timeout: 60_000 });

/** Waits until the read-out is like this. @param {import("playwright-core").Page} page @param {string} selector @param {RegExp} text */
export const reads = (page, selector, text) => page.waitForFunction(
  ([selector, source]) => new RegExp(source).test(document.querySelector(selector)?.textContent ?? ""), /** @type {const} */ ([selector, text.source]), { timeout: 30_000 });

/** Sends the arm from side to side until it is seen moving: a busy machine may miss a whole move. @param {import("playwright-core").Page} page */
export async function setMoving(page) {
  for (let azimuth = -170; ; azimuth = -azimuth) {
    await page.locator(".rig-az").fill(String(azimuth));
    await page.getByRole("button", { name: "Go to" }).click();
    const seen = await page.waitForFunction(azimuth => {
      if (document.querySelector(".rd-state")?.textContent === "Run") return "moving";
      return document.querySelector(".rd-azimuth")?.textContent === `${azimuth.toFixed(2)}°` ? "there" : null;
    }, azimuth, { timeout: 30_000 });
    if (await seen.jsonValue() === "moving") return;
  }
}

/** @param {import("playwright-core").Page} page */
export const lines = page => page.evaluate(() => /** @type {any} */ (window).rigTest.port.board.lines());

/** @param {import("playwright-core").Page} page */
export async function home(page) {
  await page.getByRole("button", { name: "Home", exact: true }).click();
  await page.waitForFunction(() => document.querySelector(".rd-trust")?.textContent === "known, homed", null, { timeout: 60_000 });
}
