// The rig view: cameras, mask, mirror sphere, where a session is kept; and axe.

import assert from "node:assert/strict";
import { createRequire } from "node:module";
import { test } from "node:test";
import { crc32, deflateSync } from "node:zlib";
import { connect, state, withRig } from "./rig_support.js";
import { launch } from "./support.js";

const AXE = createRequire(import.meta.url).resolve("axe-core/axe.min.js");

test("the mirror sphere's directions are shown, used, and the arm is fitted to them", async () => {
  await withRig(async page => {
    await page.locator(".rig-ball").check();
    await page.locator(".rig-askew").check();
    await connect(page, "simulated");
    await state(page, /Connected/);
    await page.locator(".rig-planner").selectOption("random");
    await page.locator(".rig-lights").fill("4");
    await page.locator(".rig-auto").click();
    await page.getByText("4 of 4 lights. Done.").waitFor({ timeout: 60_000 });
    assert.match(await page.locator(".rig-table tbody tr").first().innerText(), /[3-6]\.\d° off ±0\.\d°/);
    assert.equal(await page.locator(".rig-measured-mark").count(), 4);
    await page.getByRole("button", { name: "Fit how the arm stands" }).click();
    await page.getByText(/azimuth [34]\.\d+°, slant -[12]\.\d+°.*Largest deviation of 4 directions: [3-6]\.\d+° before, 0\.\d+° after/).waitFor();
    await page.getByText(/Normals, error \d/).waitFor();
    // The next capture goes by it, also after a reload.
    await page.reload();
    await page.getByRole("tab", { name: "Rig" }).click();
    await page.locator(".rig-planner option").first().waitFor({ state: "attached" });
    await page.locator(".rig-ball").check();
    await page.locator(".rig-askew").check();
    await connect(page, "simulated");
    await state(page, /Connected/);
    await page.locator(".rig-lights").fill("3");
    await page.locator(".rig-next").click();
    await page.locator(".rig-table tbody tr").first().waitFor({ timeout: 60_000 });
    assert.match(await page.locator(".rig-table tbody tr").first().innerText(), /0\.\d° off ±0\.\d°/);
    await page.getByRole("button", { name: "Forget the fit" }).click();
    await page.getByText("The arm is taken to stand as it is drawn.").waitFor();
    assert.equal(await page.evaluate(() => localStorage.getItem("coil-ps.arm")), null);
  }, false);
});

test("a webcam: opened, held still, mask by threshold, three lights", async () => {
  const own = await launch(["--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream"]);
  try {
    await withRig(async page => {
      await page.locator(".rig-camera").selectOption("webcam");
      await page.getByRole("button", { name: "Open camera" }).click();
      await page.getByText(/\d+ × \d+ pixels\..*sRGB/).waitFor({ timeout: 20_000 });
      assert.ok(await page.locator(".rig-device option").count() > 1, "the devices are named after the permission");
      await page.getByRole("button", { name: "Take a picture" }).click();
      await page.getByText(/Mark the object/).waitFor({ timeout: 20_000 });
      await page.getByRole("button", { name: "Mask by threshold" }).click();
      await page.getByText(/Mask \d+ pixels; saturated \d+\.\d %, dark \d+\.\d %, noise \d+\.\d %/).waitFor();
      await connect(page, "simulated");
      await state(page, /Connected/);
      await page.locator(".rig-lights").fill("3");
      await page.locator(".rig-average").fill("2");
      await page.locator(".rig-auto").click();
      await page.getByText("3 of 3 lights. Done.").waitFor({ timeout: 90_000 });
      assert.ok(await page.evaluate(() => /** @type {HTMLCanvasElement} */ (document.querySelector(".rig-normals")).width > 8));
    }, false, own);
  } finally {
    await own.close();
  }
});

test("a webcam that may not be used is explained", async () => {
  const own = await launch(["--use-fake-device-for-media-stream"]);
  try {
    await withRig(async page => {
      await page.locator(".rig-camera").selectOption("webcam");
      await page.getByRole("button", { name: "Open camera" }).click();
      await page.getByText("The browser may not use the camera: allow it for this page").waitFor({ timeout: 20_000 });
    }, false, own);
  } finally {
    await own.close();
  }
});

/** A 16-bit grey-in-RGB PNG: a bright disc to mark, and a dark ball with a highlight beside it. */
function photo() {
  const [w, h] = [120, 80];
  const rows = Buffer.alloc(h * (1 + 6 * w));
  for (let y = 0; y < h; y += 1) {
    for (let x = 0; x < w; x += 1) {
      const disc = Math.hypot(x + 0.5 - 40, y + 0.5 - 40) < 30;
      const spot = Math.hypot(x + 0.5 - 104, y + 0.5 - 34) < 2;
      const value = spot ? 4095 : disc ? 2000 : 30;
      for (let c = 0; c < 3; c += 1) rows.writeUInt16BE(value, y * (1 + 6 * w) + 1 + 6 * x + 2 * c);
    }
  }
  const chunk = (/** @type {string} */ type, /** @type {Buffer} */ data) => {
    const body = Buffer.concat([Buffer.from(type, "latin1"), data]);
    const out = Buffer.alloc(body.length + 8);
    out.writeUInt32BE(data.length);
    body.copy(out, 4);
    out.writeUInt32BE(crc32(body), body.length + 4);
    return out;
  };
  const header = Buffer.alloc(13);
  header.writeUInt32BE(w);
  header.writeUInt32BE(h, 4);
  header.set([16, 2, 0, 0, 0], 8);
  return Buffer.concat([Buffer.from("\x89PNG\r\n\x1a\n", "latin1"), chunk("IHDR", header), chunk("IDAT", deflateSync(rows)), chunk("IEND", Buffer.alloc(0))]);
}

/** Clicks on a point of the picture, in its own pixels. @param {import("playwright-core").Page} page @param {number} x @param {number} y */
async function clickPicture(page, x, y) {
  const box = await page.locator(".rig-over").boundingBox();
  assert.ok(box);
  await page.locator(".rig-over").click({ position: { x: x / 120 * box.width, y: y / 80 * box.height } });
}

test("images chosen for each light; the mask is drawn, the mirror sphere marked by clicks", async () => {
  await withRig(async page => {
    const file = { name: "1.png", mimeType: "image/png", buffer: photo() };
    const give = async (/** @type {string | RegExp} */ name, /** @type {any} */ files) => {
      const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.getByRole("button", { name }).click()]);
      await chooser.setFiles(files);
    };
    await page.locator(".rig-camera").selectOption("files");
    await page.locator(".rig-white").fill("4095");
    await give("Take a picture", [file]);
    await page.getByText("Mark the object").waitFor();
    // A square of 40 × 40 pixels, and a brush stroke beside it taken away again.
    for (const [x, y] of [[20, 20], [60, 20], [60, 60], [20, 60]]) await clickPicture(page, x, y);
    await page.getByRole("button", { name: "Close polygon" }).click();
    await page.getByText(/Mask 1[56]\d\d pixels/).waitFor();
    const drawn = Number(/Mask (\d+)/.exec(await page.locator(".rig-sketch").innerText())?.[1]);
    assert.ok(Math.abs(drawn - 1600) < 60, `${drawn}`);
    await page.getByLabel("Erase").check();
    await clickPicture(page, 40, 40);
    await page.waitForFunction(before => Number(/Mask (\d+)/.exec(document.querySelector(".rig-sketch")?.textContent ?? "")?.[1]) < before, drawn);
    // The sphere: three clicks on its rim.
    await page.getByLabel("mirror sphere beside the object").check();
    await page.getByLabel("Sphere’s rim").check();
    for (const [x, y] of [[85, 40], [115, 40], [100, 25]]) await clickPicture(page, x, y);
    await page.waitForFunction(() => Math.abs(Number(/** @type {HTMLInputElement} */ (document.querySelector(".rig-cr")).value) - 15) < 0.6);
    await page.getByRole("button", { name: "Measure the light" }).click();
    await page.getByText(/Light at azimuth 5\d\.\d°, slant [56]\d\.\d°, ±\d\.\d\d°/).waitFor();
    await connect(page, "simulated");
    await state(page, /Connected/);
    await page.getByText("Exposure and travel").click();
    await page.locator(".rig-exposures").fill("1, 4");
    await page.locator(".rig-lights").fill("3");
    await page.locator(".rig-auto").click();
    await give("Choose the 2 images of light 1", [file, { ...file, name: "2.png" }, { ...file, name: "3.png" }]);
    await page.getByText("3 images were chosen where light 1 needs 2: choose again.").waitFor();
    for (let k = 1; k <= 3; k += 1) await give(`Choose the 2 images of light ${k}`, [file, { ...file, name: "2.png" }]);
    await page.getByText("3 of 3 lights. Done.").waitFor({ timeout: 60_000 });
    // That highlight is nowhere near the arm: said, and not used.
    assert.match(await page.locator(".rig-notes").innerText(), /the mirror sphere shows a light \d+\.\d° from where the arm was sent/);
    // What a camera took is not written over unasked.
    await page.locator(".rig-auto").click();
    await page.getByText("This browser keeps a session of 3 of 3 lights that is nowhere else").waitFor();
    await page.getByRole("button", { name: "Discard it" }).click();
    await page.getByText("The stored session was discarded.").waitFor();
    await page.locator(".rig-auto").click();
    await page.getByRole("button", { name: "Choose the 2 images of light 1" }).waitFor({ timeout: 60_000 });
    await page.locator(".rig-pause").click();
  }, false);
});

test("a watched folder; the session is also saved to a chosen one", async () => {
  await withRig(async page => {
    await page.evaluate(() => {
      // The picker of the browser, with folders of its own storage.
      /** @type {any} */ (window).showDirectoryPicker = async (/** @type {{ id: string }} */ { id }) =>
        (await navigator.storage.getDirectory()).getDirectoryHandle(`chosen-${id}`, { create: true });
    });
    const file = { name: "look.png", mimeType: "image/png", buffer: photo() };
    await page.locator(".rig-camera").selectOption("folder");
    await page.locator(".rig-white").fill("4095");
    await page.getByRole("button", { name: "Choose the folder…" }).click();
    await page.getByText("Watching “chosen-rig-camera”").waitFor();
    const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.getByRole("button", { name: "Take a picture" }).click()]);
    await chooser.setFiles([file]);
    await page.getByRole("button", { name: "Mask by threshold" }).click();
    await page.getByText(/Mask 28\d\d pixels/).waitFor();
    await page.getByRole("button", { name: "Save to a folder…" }).click();
    await page.getByText("Also saved to “chosen-rig-session”").waitFor();
    await connect(page, "simulated");
    await state(page, /Connected/);
    await page.getByText("Exposure and travel").click();
    await page.locator(".rig-exposures").fill("2");
    await page.locator(".rig-lights").fill("3");
    await page.locator(".rig-auto").click();
    // A camera that saves four images a second, whether it is asked to or not.
    const filled = page.evaluate(async bytes => {
      const folder = await (await navigator.storage.getDirectory()).getDirectoryHandle("chosen-rig-camera");
      for (let k = 0; !document.querySelector(".rig-progress")?.textContent?.includes("Done"); k += 1) {
        const stream = await (await folder.getFileHandle(`${String(k).padStart(5, "0")}.png`, { create: true })).createWritable();
        await stream.write(new Uint8Array(bytes));
        await stream.close();
        await new Promise(resolve => setTimeout(resolve, 250));
      }
    }, [...photo()]);
    await page.getByText("3 of 3 lights. Done.").waitFor({ timeout: 90_000 });
    await filled;
    const saved = await page.evaluate(async () => {
      const folder = await (await navigator.storage.getDirectory()).getDirectoryHandle("chosen-rig-session");
      const names = [];
      for await (const name of /** @type {any} */ (folder).keys()) names.push(name);
      const record = await (await (await folder.getFileHandle("session.json")).getFile()).text();
      return { names, shots: JSON.parse(record).shots.length };
    });
    assert.equal(saved.shots, 3);
    for (const name of ["001.png", "003.png", "mask.png", "lights.lp", "light_directions.txt"]) assert.ok(saved.names.includes(name), name);
  }, false);
});

test("one light at a time; dark frame; nearby lights", async () => {
  await withRig(async page => {
    await connect(page, "simulated");
    await state(page, /Connected/);
    await page.getByText("Exposure and travel").click();
    await page.getByLabel("dark frame").check();
    await page.getByLabel("prefer nearby lights").fill("5");
    await page.locator(".rig-lights").fill("3");
    await page.locator(".rig-next").click();
    await page.getByText("1 of 3 lights. Paused.").waitFor({ timeout: 60_000 });
    await page.locator(".rig-next").click();
    await page.getByText("2 of 3 lights. Paused.").waitFor({ timeout: 60_000 });
    assert.match(await page.locator(".rig-budget").innerText(), /move \d+ ms, settle 300 ms, expose \d+ ms/);
    assert.match(await page.locator(".rig-lines").innerText(), /> M5[\s\S]*> M3S800/);
  }, false);
});

test("what is missing or out of range is named before anything moves", async () => {
  await withRig(async page => {
    await connect(page, "simulated");
    await state(page, /Connected/);
    await page.getByText("Exposure and travel").click();
    for (const [field, wrong, said] of [
      [".rig-settle", "", "Time to settle: a number from 0 to 30 is needed."],
      [".rig-lights", "3.5", "Lights: a whole number from 3 to 100 is needed."],
      [".rig-reach", "120", "Largest slant: a number from 1 to 90 is needed."],
    ]) {
      const before = await page.locator(field).inputValue();
      await page.locator(field).fill(wrong);
      await page.locator(".rig-auto").click();
      await page.getByText(said).waitFor();
      await page.locator(field).fill(before);
    }
    await page.locator(".rig-az").fill("");
    await page.getByRole("button", { name: "Go to" }).click();
    await page.getByText("Azimuth: a number from -360 to 360 is needed.").waitFor();
    assert.equal(await page.locator(".rd-state").innerText(), "Alarm", "not homed yet: nothing has moved");
  }, false);
});

test("a capture ends where the predicted error is low enough", async () => {
  await withRig(async page => {
    await connect(page, "simulated");
    await state(page, /Connected/);
    await page.locator(".rig-lights").fill("12");
    await page.locator(".rig-stop-at").fill("80");
    await page.locator(".rig-auto").click();
    await page.getByText("5 of 5 lights. Done.").waitFor({ timeout: 90_000 });
    assert.equal(await page.locator(".rig-table tbody tr").count(), 5);
  }, false);
});

test("the rig view passes axe, wide and narrow, light and dark", async () => {
  await withRig(async page => {
    for (const [width, scheme] of /** @type {const} */ ([[1440, "light"], [390, "dark"]])) {
      await page.setViewportSize({ width, height: 900 });
      await page.emulateMedia({ colorScheme: scheme });
      for (const camera of ["sim", "webcam", "files"]) {
        await page.locator(".rig-camera").selectOption(camera);
        await page.addScriptTag({ path: AXE });
        const found = await page.evaluate(async () => {
          const { violations } = await /** @type {any} */ (window).axe.run("#view-rig");
          return violations.map((/** @type {any} */ v) => `${v.id}: ${v.nodes.map((/** @type {any} */ n) => n.html).join(" ")}`);
        });
        assert.deepEqual(found, [], `${width} ${scheme} ${camera}`);
      }
      assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), `no sideways scrolling at ${width}`);
    }
  }, false);
});
