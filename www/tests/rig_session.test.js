// The rig view: a session in a folder of the user's, continued after a reload, a lost folder, or from the command line.

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtemp, readFile, readdir, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { connect, state, withRig } from "./rig_support.js";
import { COIL } from "./support.js";

/** @typedef {import("playwright-core").Page} Page */

/** The browser's picker gives a folder of its own storage: a real handle, which the page can keep. @param {Page} page @param {string} name */
async function picks(page, name) {
  await page.evaluate(name => {
    /** @type {any} */ (window).showDirectoryPicker = async () => (await navigator.storage.getDirectory()).getDirectoryHandle(name, { create: true });
  }, name);
}

/** @param {Page} page @param {string} name */
async function chooseFolder(page, name) {
  await picks(page, name);
  await page.locator(".rig-folder").click();
  await page.getByText(`Also saved to “${name}”`).waitFor();
}

/** The record that lies in a folder of the browser's storage. @param {Page} page @param {string} name @returns {Promise<any>} */
const record = (page, name) => page.evaluate(async name => {
  const folder = await (await navigator.storage.getDirectory()).getDirectoryHandle(name);
  return JSON.parse(await (await (await folder.getFileHandle("session.json")).getFile()).text());
}, name);

/** @param {Page} page @param {string} name */
const remove = (page, name) => page.evaluate(async name => (await navigator.storage.getDirectory()).removeEntry(name, { recursive: true }), name);

/** @param {Page} page */
async function reload(page) {
  await page.reload();
  await page.getByRole("tab", { name: "Rig" }).click();
  await page.locator(".rig-planner option").first().waitFor({ state: "attached" });
}

/** @param {Page} page @param {RegExp} text */
const continues = (page, text) => page.waitForFunction(source => {
  const button = /** @type {HTMLElement} */ (document.querySelector(".rig-continue"));
  return !button.hidden && new RegExp(source).test(button.textContent ?? "");
}, text.source, { timeout: 30_000 });

/** One light of a new session. @param {Page} page @param {number} lights */
async function takeOne(page, lights) {
  await connect(page, "simulated");
  await state(page, /Connected/);
  await page.locator(".rig-lights").fill(String(lights));
  await page.locator(".rig-next").click();
  await page.getByText(`1 of ${lights} lights. Paused.`).waitFor({ timeout: 90_000 });
}

/** @param {Page} page @param {number} lights */
const done = (page, lights) => page.getByText(`${lights} of ${lights} lights. Done.`).waitFor({ timeout: 180_000 });

test("a session in a chosen folder goes on after a reload, also where the browser has lost its own copy", async () => {
  await withRig(async page => {
    await chooseFolder(page, "bust");
    // What the page would not ask for after a reload.
    await page.getByText("Exposure and travel").click();
    await page.getByLabel("prefer nearby lights").fill("5");
    await takeOne(page, 4);
    await reload(page);
    await continues(page, /^Continue session \(1 of 4 lights\) in folder “bust”$/);
    await remove(page, "rig-session");
    await page.locator(".rig-continue").click();
    await page.getByText("Connect the arm first").waitFor();
    await continues(page, /^Continue \(1 of 4 lights\)$/);
    assert.equal(await page.locator(".rig-table tbody tr").count(), 1, "what is there is shown");
    await connect(page, "simulated");
    await state(page, /Connected/);
    await page.locator(".rig-continue").click();
    await done(page, 4);
    for (const name of ["bust", "rig-session"]) {
      const { shots, nearby, notes } = await record(page, name);
      assert.deepEqual([shots.length, nearby], [4, 5], name);
      assert.match(notes.join("\n"), /continued after 1 of 4 lights/);
    }
    // There is nothing left to go on with, and the next capture does not write over it.
    await page.locator(".rig-auto").click();
    await page.getByText("“bust” holds a session: continue it, or choose another folder").waitFor();
    await reload(page);
    assert.ok(await page.locator(".rig-continue").isHidden());
  }, false);
});

test("a folder that may not be used again: the browser's own copy goes on", async () => {
  await withRig(async page => {
    await takeOne(page, 3);
    await chooseFolder(page, "later"); // in the middle: what was taken is copied
    assert.equal((await record(page, "later")).shots.length, 1);
    await reload(page);
    await continues(page, /in folder “later”$/);
    await page.evaluate(() => { /** @type {any} */ (FileSystemHandle.prototype).requestPermission = async () => "denied"; });
    await connect(page, "simulated");
    await state(page, /Connected/);
    await page.locator(".rig-continue").click();
    await page.getByText("The folder “later” can't be opened: the browser was not allowed to use it. Continue goes on with the copy").waitFor();
    await continues(page, /^Continue \(1 of 3 lights\)$/);
    await page.locator(".rig-continue").click();
    await done(page, 3);
    assert.equal((await record(page, "later")).shots.length, 1, "it was not touched");
  }, false);
});

test("a folder that vanishes, and a browser without folders", async () => {
  await withRig(async page => {
    await chooseFolder(page, "stick");
    await takeOne(page, 3);
    await remove(page, "stick");
    await page.locator(".rig-next").click();
    await page.getByText(/The folder “stick” can't be used any more/).waitFor({ timeout: 90_000 });
    // The light was stored in the browser before.
    await continues(page, /^Continue \(2 of 3 lights\)$/);
    await chooseFolder(page, "other");
    await page.locator(".rig-continue").click();
    await done(page, 3);
    assert.equal((await record(page, "other")).shots.length, 3);

    for (const [answer, text] of /** @type {const} */ ([[null, "This browser can't write to folders"], ["AbortError", "or none was chosen"], ["SecurityError", "The browser does not allow"]])) {
      await page.evaluate(answer => {
        /** @type {any} */ (window).showDirectoryPicker = answer && (async () => { throw new DOMException("no", answer); });
      }, answer);
      await page.locator(".rig-folder").click();
      await page.locator(".rig-said").filter({ hasText: text }).waitFor();
    }
  }, false);
});

test("a session of the command line is shown, and continued", async () => {
  const out = await mkdtemp(join(tmpdir(), "coil-session-"));
  try {
    const { status, stderr } = spawnSync(COIL(), ["capture", "--out", out, "--planner", "random", "-t", "4", "--size", "48"], { encoding: "utf8" });
    assert.equal(status, 0, stderr);
    const files = await Promise.all((await readdir(out)).map(async name => ({ name, bytes: [...await readFile(join(out, name))] })));
    await withRig(async page => {
      const put = (/** @type {string} */ folder, /** @type {{ name: string, bytes: number[] }[]} */ some) => page.evaluate(async ([folder, files]) => {
        const handle = await (await navigator.storage.getDirectory()).getDirectoryHandle(folder, { create: true });
        for (const { name, bytes } of files) {
          const stream = await (await handle.getFileHandle(name, { create: true })).createWritable();
          await stream.write(new Uint8Array(bytes));
          await stream.close();
        }
      }, /** @type {const} */ ([folder, some]));
      await put("complete", files);
      await chooseFolder(page, "complete");
      await page.getByText("“complete” holds a complete session of “blob:7”, 4 of 4 lights: shown here.").waitFor();
      assert.equal(await page.locator(".rig-table tbody tr").count(), 4);
      assert.match(await page.locator(".rig-error").innerText(), /error \d+\.\d\d°/);
      assert.ok(await page.locator(".rig-continue").isHidden());
      const [zip] = await Promise.all([page.waitForEvent("download"), page.locator(".rig-zip").click()]);
      assert.ok((await readFile(await zip.path())).includes("session/004.png"));
      await page.getByRole("button", { name: "Not to a folder" }).click();
      await page.getByText("Save to a folder…").waitFor();

      // Cut off before the last light was recorded.
      const text = files.find(f => f.name === "session.json");
      const cut = JSON.parse(Buffer.from(text?.bytes ?? []).toString());
      cut.shots.pop();
      await put("cut", [...files.filter(f => f !== text && f.name !== "004.png"), { name: "session.json", bytes: [...Buffer.from(JSON.stringify(cut))] }]);
      await chooseFolder(page, "cut");
      await page.getByText("“cut” holds an unfinished session of “blob:7”, 3 of 4 lights: shown here.").waitFor();
      await continues(page, /^Continue \(3 of 4 lights\)$/);
      await connect(page, "simulated");
      await state(page, /Connected/);
      await page.locator(".rig-continue").click();
      await done(page, 4);
      const { shots } = await record(page, "cut");
      const whole = JSON.parse(Buffer.from(text?.bytes ?? []).toString());
      assert.deepEqual(shots[3].requested, whole.shots[3].requested, "the light that the command line took");
    }, false);
  } finally {
    await rm(out, { recursive: true });
  }
});
