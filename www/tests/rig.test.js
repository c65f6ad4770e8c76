// The rig view: connecting, moving, stopping, capturing, and what goes wrong meanwhile.

import assert from "node:assert/strict";
import { test } from "node:test";
import { connect, home, lines, passed, reads, setMoving, site, standInWorker, state, withRig } from "./rig_support.js";

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
    await passed(page, /waiting for the firmware/, /Connected: Grbl 1\.1h/);
    await reads(page, ".rd-state", /^Alarm$/);
    await page.getByRole("button", { name: "Disconnect" }).click();
    await state(page, /Not connected/);
    await page.waitForFunction(() => /** @type {any} */ (window).rigTest.port.readable === null); // the port is closed
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
    await reads(page, ".rd-azimuth", /^35\.0/);
    await setMoving(page);
    await page.getByRole("button", { name: "STOP", exact: true }).click();
    await state(page, /Stopped\. Release/);
    const before = (await lines(page)).length;
    for (const name of ["Go to", "Home", "Resume"]) await page.getByRole("button", { name, exact: true }).click();
    await page.waitForFunction(() => /stopped/.test(document.querySelector(".rig-said")?.textContent ?? ""));
    await page.waitForTimeout(700);
    assert.equal((await lines(page)).length, before, "no line after Stop");
    await reads(page, ".rd-state", /^Alarm$/);
    await reads(page, ".rd-trust", /lost/);
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
    // The page itself pulls it, when the next move is shown: between being told and pulling, the move might end.
    await page.evaluate(() => {
      const { rigTest } = /** @type {any} */ (window);
      const shown = /** @type {Element} */ (document.querySelector(".rd-state"));
      const observer = new MutationObserver(() => {
        if (shown.textContent !== "Run") return;
        observer.disconnect();
        rigTest.gone = true;
        rigTest.port.unplug();
        setTimeout(() => { rigTest.gone = false; }, 1500);
      });
      observer.observe(shown, { childList: true, characterData: true, subtree: true });
    });
    await passed(page, /Connected/, /reconnect/, /Connected/);
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
    assert.match(await button.innerText(), /Continue \([4-9] of 10 lights\)/);
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

test("a board that can't home is told where it is; one that can is not asked", async () => {
  await withRig(async page => {
    const here = page.getByRole("button", { name: "Here is 0°, 0°" });
    await page.evaluate(() => { /** @type {any} */ (window).rigTest.kind = "stock"; });
    await connect(page, "choose");
    await state(page, /Connected/);
    await here.click();
    await page.waitForFunction(() => /> G21G10L20P1X0\.000Y0\.000/.test(document.querySelector(".rig-lines")?.textContent ?? ""));
    await page.getByRole("button", { name: "Disconnect" }).click();
    await connect(page, "simulated");
    await state(page, /Connected/);
    assert.ok(await here.isHidden());
  });
});

test("Stop while the network loads: no capture follows", async t => {
  await withRig(async page => {
    if (!await page.locator(".rig-planner option[value=coil]").count()) return t.skip("the module of the learned planner is not built");
    let letGo = () => {};
    const held = new Promise(resolve => { letGo = () => resolve(null); });
    await page.route("**/models/compact/step.onnx", async route => { await held; await route.continue().catch(() => {}); });
    await connect(page, "simulated");
    await state(page, /Connected/);
    await page.locator(".rig-planner").selectOption("coil");
    await page.locator(".rig-auto").click();
    // The other view may be fetching it too.
    await page.locator(".rig-progress", { hasText: "fetching the network of coil" }).waitFor({ timeout: 120_000 });
    assert.ok(await page.locator(".rig-auto").isDisabled(), "one capture at a time");
    await page.locator(".rig-stop").click();
    await page.getByText("Ended before the first light.").waitFor();
    letGo();
    await state(page, /Stopped\. Release Stop/);
    await page.waitForTimeout(1500);
    assert.match(await page.locator(".rig-state").innerText(), /Stopped/);
    assert.equal(await page.locator(".rd-state").innerText() === "Home", false);
    assert.equal(await page.locator(".rig-table tbody tr").count(), 0);
    assert.ok(await page.locator(".rig-auto").isEnabled());
  }, false);
});

test("a fit that can't be read is dropped, and the view opens", async () => {
  await withRig(async page => {
    await page.evaluate(() => localStorage.setItem("coil-ps.arm", "{broken"));
    await page.reload();
    await page.getByRole("tab", { name: "Rig" }).click();
    await page.getByText("The fit of an earlier session can't be read and was dropped").waitFor();
    assert.equal(await page.evaluate(() => localStorage.getItem("coil-ps.arm")), null);
    await connect(page, "simulated");
    await state(page, /Connected/);
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

test("a port in a worker of its own; Stop waits for no worker", async () => {
  for (const place of ["worker", "page"]) {
    await withRig(async page => {
      if (place === "worker") {
        const isPort = (/** @type {import("playwright-core").Worker} */ w) => w.url().includes("port-worker");
        const worker = page.workers().find(isPort) ?? await page.waitForEvent("worker", isPort);
        await worker.evaluate(standInWorker, site.url);
      }
      await connect(page, "choose");
      await state(page, /Connected/);
      assert.equal(await page.locator(".rig").getAttribute("data-port"), place);
      await home(page);
      await setMoving(page);
      // The rig's worker computes for seconds; the arm stops all the same.
      const rig = page.workers().find(w => w.url().includes("rig/worker"));
      let free = false;
      const busy = rig?.evaluate(() => { for (const end = performance.now() + 6000; performance.now() < end;); }).then(() => { free = true; });
      await page.getByRole("button", { name: "STOP", exact: true }).click();
      const board = /** @type {import("playwright-core").Page} */ (place === "page" ? page : page.workers().find(w => w.url().includes("port-worker")));
      for (let moved = 1; moved !== 0;) {
        moved = await board.evaluate(async () => {
          const { board } = /** @type {any} */ (self).rigTest.port;
          const before = board.truth()[0];
          await new Promise(resolve => setTimeout(resolve, 60));
          return Math.abs(board.truth()[0] - before);
        });
        assert.ok(moved === 0 || !free, "the arm moves on until the worker has time");
      }
      await busy;
      await state(page, /Stopped\. Release/);
    });
  }
});
