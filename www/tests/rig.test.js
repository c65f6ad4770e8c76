// The rig view in Chromium: a Web Serial stand-in at `navigator.serial`, behind it the simulated Grbl of the core.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { launch, openPage, servePage } from "./support.js";

/** @type {Awaited<ReturnType<typeof servePage>>} */
let site;
/** @type {import("playwright-core").Browser} */
let browser;
before(async () => { site = await servePage(); browser = await launch(); });
after(async () => { await browser?.close(); site?.close(); });

/** Puts a serial API in place whose one port is the simulated board. Runs in the page before it loads. */
function standIn() {
  /** @type {any} */
  const w = window;
  w.rigTest = { answer: "board", remembered: false, gone: false };
  /** @type {any} */
  let port = null;
  const made = async () => {
    if (port) return port;
    const { default: init } = await import(new URL("pkg/core/coil_ps.js", document.baseURI).href);
    await init({ module_or_path: new URL("pkg/core/coil_ps_bg.wasm", document.baseURI) });
    const { SimulatedPort } = await import(new URL("rig/simulated.js", document.baseURI).href);
    port = new SimulatedPort("guide");
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

/**
 * @param {(page: import("playwright-core").Page) => Promise<void>} body
 * @param {boolean} [serial] with the stand-in
 */
async function withRig(body, serial = true) {
  const { page, context, complaints } = await openPage(browser);
  try {
    if (serial) await page.addInitScript(standIn);
    await page.goto(site.url);
    await page.getByRole("tab", { name: "Rig" }).click();
    await page.locator(".rig-planner option").first().waitFor({ state: "attached" });
    await body(page);
    assert.deepEqual(complaints.filter(c => !/Failed to load resource/.test(c)), []);
  } finally {
    await context.close();
  }
}

/** @param {import("playwright-core").Page} page @param {string} choice */
async function connect(page, choice) {
  await page.locator(".rig-port").selectOption(choice);
  await page.getByRole("button", { name: "Connect", exact: true }).click();
}

/** @param {import("playwright-core").Page} page @param {RegExp} text */
const state = (page, text, timeout = 20_000) => page.waitForFunction(
  source => new RegExp(source).test(document.querySelector(".rig-state")?.textContent ?? ""), text.source, { timeout });

/** @param {import("playwright-core").Page} page */
const lines = page => page.evaluate(() => /** @type {any} */ (window).rigTest.port.board.lines());

/** @param {import("playwright-core").Page} page */
async function home(page) {
  await page.getByRole("button", { name: "Home", exact: true }).click();
  await page.waitForFunction(() => document.querySelector(".rd-trust")?.textContent === "known, homed", null, { timeout: 60_000 });
}

test("denied, busy, then connected only after the banner", async () => {
  await withRig(async page => {
    await page.evaluate(() => { /** @type {any} */ (window).rigTest.answer = "deny"; });
    await connect(page, "choose");
    await page.getByRole("heading", { name: "No port chosen" }).waitFor();
    assert.match(await page.locator("dialog[open]").innerText(), /data cable[\s\S]*dialout/);
    await page.getByRole("button", { name: "Close" }).click();

    await page.evaluate(() => { /** @type {any} */ (window).rigTest.answer = "busy"; });
    await connect(page, "choose");
    await page.getByText("The port is busy: another program has it open").waitFor();

    await page.evaluate(() => { /** @type {any} */ (window).rigTest.answer = "board"; });
    await connect(page, "port0");
    await state(page, /waiting for the firmware/);
    await state(page, /Connected: Grbl 1\.1h/);
    assert.equal(await page.locator(".rd-state").innerText(), "Alarm");
    await page.getByRole("button", { name: "Disconnect" }).click();
    await state(page, /Not connected/);
    assert.equal(await page.evaluate(() => /** @type {any} */ (window).rigTest.port.readable), null, "the port is closed");
  });
});

test("home, go, jog; Stop ends everything and no move follows", async () => {
  await withRig(async page => {
    await connect(page, "choose");
    await state(page, /Connected/);
    await home(page);
    await page.getByRole("button", { name: "Go to" }).click();
    await page.waitForFunction(() => document.querySelector(".rd-azimuth")?.textContent === "30.00°" && document.querySelector(".rd-state")?.textContent === "Idle", null, { timeout: 20_000 })
      .catch(async () => assert.fail(await page.locator(".rig-read").innerText()));
    await page.getByRole("button", { name: "Azimuth up" }).click();
    await page.waitForFunction(() => document.querySelector(".rd-azimuth")?.textContent?.startsWith("35.0"), null, { timeout: 10_000 });
    await page.locator(".rig-az").fill("-170");
    await page.getByRole("button", { name: "Go to" }).click();
    await page.waitForFunction(() => document.querySelector(".rd-state")?.textContent === "Run");
    await page.getByRole("button", { name: "STOP", exact: true }).click();
    await state(page, /Stopped\. Release/);
    const before = (await lines(page)).length;
    for (const name of ["Go to", "Home", "Resume"]) await page.getByRole("button", { name, exact: true }).click();
    assert.match(await page.locator(".rig-said").innerText(), /stopped/);
    await page.waitForTimeout(700);
    assert.equal((await lines(page)).length, before, "no line after Stop");
    assert.equal(await page.locator(".rd-state").innerText(), "Alarm");
    assert.match(await page.locator(".rd-trust").innerText(), /lost/);
    await page.getByRole("button", { name: "Release Stop" }).click();
    await home(page);
    assert.match(await page.locator(".rig-lines").innerText(), /> \$H[\s\S]*ALARM:3/);
  });
});

test("the cable is pulled in mid-move; it reconnects, and the capture goes on", async () => {
  await withRig(async page => {
    await connect(page, "choose");
    await state(page, /Connected/);
    await page.locator(".rig-lights").fill("4");
    await page.locator(".rig-auto").click();
    await page.locator(".rig-table tbody tr").nth(0).waitFor({ timeout: 60_000 });
    await page.waitForFunction(() => document.querySelector(".rd-state")?.textContent === "Run", null, { timeout: 20_000 });
    await page.evaluate(() => {
      const { rigTest } = /** @type {any} */ (window);
      rigTest.gone = true;
      rigTest.port.unplug();
      setTimeout(() => { rigTest.gone = false; }, 1500);
    });
    await state(page, /reconnect/);
    await state(page, /Connected/);
    await page.getByText("4 of 4 lights. Done.").waitFor({ timeout: 90_000 });
    assert.equal(await page.locator(".rig-table tbody tr").count(), 4);
  });
});

test("ten lights with the simulated arm, a reload in between, nothing lost", async () => {
  await withRig(async page => {
    await connect(page, "simulated");
    await state(page, /Connected/);
    await page.locator(".rig-auto").click();
    await page.locator(".rig-table tbody tr").nth(3).waitFor({ timeout: 120_000 });
    await page.reload();
    await page.getByRole("tab", { name: "Rig" }).click();
    const button = page.locator(".rig-continue");
    await button.waitFor({ timeout: 20_000 });
    assert.match(await button.innerText(), /Continue \([4-6] of 10 lights\)/);
    await connect(page, "simulated");
    await state(page, /Connected/);
    await button.click();
    await page.getByText("10 of 10 lights. Done.").waitFor({ timeout: 180_000 });
    assert.equal(await page.locator(".rig-table tbody tr").count(), 10);
    assert.match(await page.locator(".rig-error").innerText(), /error \d+\.\d\d°/);
    assert.ok(await page.evaluate(() => /** @type {HTMLCanvasElement} */ (document.querySelector(".rig-normals")).width > 50));
    const [zip] = await Promise.all([page.waitForEvent("download"), page.locator(".rig-zip").click()]);
    assert.equal(zip.suggestedFilename(), "session.zip");
  }, false);
});

test("without Web Serial the page says so, and the simulated arm is offered", async () => {
  await withRig(async page => {
    await page.evaluate(() => { delete (/** @type {any} */ (Navigator.prototype)).serial; });
    await connect(page, "choose");
    await page.getByText("This browser has no Web Serial").waitFor();
    assert.equal(await page.locator(".rig-port option").first().innerText(), "Simulated arm");
  }, false);
});
