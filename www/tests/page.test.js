// The page in a real browser: what a user sees and does, with mouse, keyboard and screen reader.

import assert from "node:assert/strict";
import { existsSync } from "node:fs";
import { readFile } from "node:fs/promises";
import { after, before, test } from "node:test";
import { createRequire } from "node:module";
import { join } from "node:path";
import { launch, openPage, ROOT, servePage, tableDone, TARGET } from "./support.js";

/** @typedef {import("playwright-core").Page} Page */

/** A quick table: two planners, few repetitions, an object that renders fast. */
const QUICK = "#planners=random,dc05v&lights=6&draws=2&object=sphere:1&material=red-phenolic";
/** A run that takes many seconds. */
const LONG = "#planners=oracle&lights=20&draws=200&object=sphere:1&material=red-phenolic";

/** @type {import("playwright-core").Browser} */
let browser;
/** @type {{ url: string, close: () => void }} */
let server;
before(async () => {
  server = await servePage();
  browser = await launch();
});
after(async () => {
  await browser?.close();
  server?.close();
});

/**
 * Opens the page, does something with it, and holds it to having logged nothing.
 * @param {string} hash
 * @param {(page: Page) => Promise<void>} body
 * @param {import("playwright-core").BrowserContextOptions} [options]
 */
async function withPage(hash, body, options) {
  const { page, context, complaints } = await openPage(browser, options);
  try {
    await page.goto(server.url + hash);
    await body(page);
    assert.deepEqual(complaints, [], "the console is clean");
  } finally {
    await context.close();
  }
}

/** Whether a canvas shows more than one colour. @param {Page} page @param {string} selector */
function isPainted(page, selector) {
  return page.locator(selector).evaluate(canvas => {
    if (!(canvas instanceof HTMLCanvasElement) || canvas.width < 8) return false;
    const { data } = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d")).getImageData(0, 0, canvas.width, canvas.height);
    const colours = new Set();
    for (let i = 0; i < data.length; i += 4) if (data[i + 3]) colours.add((data[i] << 16) | (data[i + 1] << 8) | data[i + 2]);
    return colours.size > 20;
  });
}

/** Waits until the step shown is this one. @param {Page} page @param {string} text */
function stepShown(page, text) {
  return page.waitForFunction(wanted => document.querySelector("#dome output")?.textContent === wanted, text, { timeout: 15_000 });
}

/** Text of the table, cell by cell. @param {Page} page */
function table(page) {
  return page.locator("#results tbody tr").evaluateAll(rows => rows.map(row => [...row.children].map(cell => cell.textContent?.trim() ?? "")));
}

test("the page begins with an object, solved, without a file or a click", async () => {
  await withPage("", async page => {
    await tableDone(page);
    assert.match(await page.locator("#object .facts").innerText(), /100 images/);
    for (const map of ["image", "normals", "errors", "relit"]) assert.ok(await isPainted(page, `.map-${map} .frame canvas`), map);
    assert.ok(await isPainted(page, ".dome-object"), "the object stands in the dome");
    const rows = await table(page);
    const names = ["Random", "DC05 ring + vertical", "TK22", "LIPIDS", "COIL-PS", "Oracle (sees the truth)"];
    const learned = rows.length === names.length; // where its module was built
    assert.deepEqual(rows.map(row => row[0]), names.filter(name => learned || name !== "COIL-PS"));
    for (const row of rows) assert.match(row[2], /^\d+\.\d\d°$/);
    assert.equal(rows.find(row => row[0].startsWith("Oracle"))?.[3], "exact", "its runs are all the same");
    assert.equal(await page.locator(".dome .light").count(), 10);
    assert.equal(await page.locator(".chart .series").count(), rows.length);
    const shown = learned ? "coil" : "dc05v";
    await page.waitForFunction(name => /** @type {HTMLSelectElement} */ (document.querySelector("#dome select.planner")).value === name, shown);
  });
});

test("steps can be scrubbed back, played, and chosen on strip, dome and chart", async () => {
  await withPage(QUICK, async page => {
    await tableDone(page);
    await page.locator("#scrub").fill("3");
    await stepShown(page, "Step 3 of 6");
    await page.waitForFunction(() => document.querySelectorAll(".dome .light.future").length === 3);
    await page.waitForFunction(() => document.querySelector(".map-normals .note")?.textContent?.startsWith("from 3 lights"));
    await page.locator("#scrub").fill("2");
    await page.getByText("Normals need three lights").waitFor();
    await page.locator(".strip button").nth(4).click();
    await stepShown(page, "Step 5 of 6");
    await page.locator(".dome [data-light='0']").click();
    await stepShown(page, "Step 1 of 6");
    await page.getByRole("button", { name: "Play the steps" }).click();
    await stepShown(page, "Step 6 of 6");
    await page.getByRole("button", { name: "DC05 ring + vertical" }).click();
    await page.waitForFunction(() => /** @type {HTMLSelectElement} */ (document.querySelector("#dome select.planner")).value === "dc05v");
  });
});

test("the pointer over the dome shows a candidate's direction and image", async () => {
  await withPage(QUICK, async page => {
    await tableDone(page);
    await page.getByRole("button", { name: "Camera’s view" }).click();
    await page.locator(".dome [data-candidate='80']").hover({ force: true });
    const tip = page.locator(".dome-tip");
    await tip.waitFor();
    assert.match(await tip.innerText(), /\d+\.png[\s\S]*azimuth -?\d+°, slant \d+°/);
    await page.waitForFunction(() => (document.querySelector(".dome-tip canvas")?.getAttribute("width") ?? "1") !== "1");
    assert.ok(await isPainted(page, ".dome-tip canvas"));
  });
});

test("dragging the sun relights the object at 30 frames a second or more", async () => {
  await withPage("", async page => {
    await tableDone(page);
    let best = 0;
    // The best of three: other programs share the machine.
    for (let attempt = 0; attempt < 3 && best < 30; attempt += 1) {
      best = Math.max(best, await page.evaluate(async () => {
        const sun = /** @type {Element} */ (document.querySelector(".dome .sun .grab"));
        const canvas = /** @type {HTMLCanvasElement} */ (document.querySelector(".map-relit .frame canvas"));
        const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
        const box = sun.getBoundingClientRect();
        const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
        const drawing = /** @type {Element} */ (sun.closest("svg"));
        const fire = (/** @type {string} */ type, /** @type {number} */ px, /** @type {number} */ py) =>
          (type === "pointerdown" ? sun : drawing).dispatchEvent(new PointerEvent(type, { bubbles: true, clientX: px, clientY: py, pointerId: 1 }));
        Element.prototype.setPointerCapture = () => {}; // made-up pointers can't be captured
        let frames = 0;
        const paint = context.putImageData.bind(context);
        context.putImageData = (/** @type {[ImageData, number, number]} */ ...args) => { frames += 1; paint(...args); };
        fire("pointerdown", x, y);
        const start = performance.now();
        let now = start;
        while (now - start < 1500) {
          now = await new Promise(requestAnimationFrame);
          const angle = (now - start) / 200;
          fire("pointermove", x + 60 * Math.cos(angle), y + 40 + 30 * Math.sin(angle));
        }
        fire("pointerup", x, y);
        return frames / ((now - start) / 1000);
      }));
    }
    console.log(`relighting: ${best.toFixed(0)} frames a second`);
    assert.ok(best >= 30, `${best.toFixed(1)} frames a second`);
  });
});

test("no task of the main thread is longer than 50 ms while the page works", async () => {
  for (const hash of ["", "#planners=dc05v,lipids&solvers=pixel,trimmed&draws=1"]) {
    await withPage(hash, async page => {
      await tableDone(page);
      // By the main thread's own clock: the observer's includes the time that other programs have taken.
      await browser.startTracing(page, { categories: ["toplevel", "devtools.timeline", "disabled-by-default-devtools.timeline"] });
      await page.evaluate(async () => {
        const settings = /** @type {HTMLFormElement} */ (document.querySelector("#settings"));
        settings.requestSubmit();
        const scrub = /** @type {HTMLInputElement} */ (document.querySelector("#scrub"));
        for (let i = 0; i < 60; i += 1) {
          await new Promise(requestAnimationFrame);
          if (scrub.disabled) continue;
          scrub.value = String(1 + i % 10);
          scrub.dispatchEvent(new Event("input", { bubbles: true }));
        }
      });
      await tableDone(page);
      await page.getByRole("button", { name: "Show in 3-D" }).click();
      await page.waitForFunction(() => document.querySelector(".map-surface canvas")?.getAttribute("width") === "360");
      const { traceEvents } = JSON.parse((await browser.stopTracing()).toString());
      const main = traceEvents.find((/** @type {any} */ e) => e.name === "thread_name" && e.args.name === "CrRendererMain");
      const tasks = traceEvents.filter((/** @type {any} */ e) => e.name === "RunTask" && e.tid === main.tid && e.pid === main.pid && e.tdur).map((/** @type {any} */ e) => e.tdur / 1000);
      assert.ok(tasks.length > 100, "the trace holds the tasks");
      console.log(`main thread: ${tasks.length} tasks, the longest ${Math.max(...tasks).toFixed(1)} ms`);
      assert.ok(Math.max(...tasks) <= 50, `${Math.max(...tasks).toFixed(1)} ms`);
    });
  }
});

test("cancel stops a run within a moment, and the page goes on working", async () => {
  await withPage(LONG, async page => {
    const cancel = page.locator("#settings .cancel");
    await page.waitForFunction(() => document.querySelectorAll(".strip button").length >= 5, null, { timeout: 30_000 });
    await cancel.click();
    await page.waitForFunction(() => document.querySelector("#settings .cancel:disabled") && document.querySelector("#settings .progress[hidden]"), null, { timeout: 1000 });
    // The worker is free again: a view of another step comes at once.
    const start = Date.now();
    await page.locator("#settings").evaluate(form => {
      const field = (/** @type {string} */ id) => /** @type {HTMLInputElement} */ (form.querySelector(id));
      [field("#lights").value, field("#draws").value] = ["4", "1"];
      form.dispatchEvent(new Event("change"));
      /** @type {HTMLFormElement} */ (form).requestSubmit();
    });
    await tableDone(page);
    assert.ok(Date.now() - start < 15_000);
    assert.equal((await table(page)).length, 1);
    assert.equal(await page.locator("#problems").innerText(), "", "a cancelled run is not a problem");
  });
});

test("rendering an object can be cancelled, and the object before it stays", async () => {
  await withPage(QUICK, async page => {
    await tableDone(page);
    await page.getByRole("button", { name: "Render an object…" }).click();
    await page.locator("#family").selectOption("knot");
    await page.getByRole("dialog").getByRole("button", { name: "Render" }).click();
    await page.locator("#object .cancel").click();
    await page.locator("#object .progress").waitFor({ state: "hidden" });
    assert.equal(await page.locator("#object-title").innerText(), "sphere");
    assert.equal(await page.locator("#problems").innerText(), "");
  });
});

test("a link holds the settings", async () => {
  const hash = "#planners=dc05,lipids&solvers=ls&lights=5&protocol=128&lookup=soft:0.05&draws=3&seed=9&object=sphere:1&material=red-phenolic";
  await withPage(hash, async page => {
    await tableDone(page);
    assert.deepEqual(await page.locator("#settings .planners input:checked").evaluateAll(list => list.map(input => /** @type {HTMLInputElement} */ (input).value)), ["dc05", "lipids"]);
    assert.equal(await page.locator("#lights").inputValue(), "5");
    assert.equal(await page.locator("#tau").inputValue(), "0.05");
    const first = await table(page);
    assert.equal(first.length, 2);
    await page.locator("#seed").fill("10");
    await page.locator("#seed").blur();
    await page.waitForURL(/seed=10/);
    await page.context().grantPermissions(["clipboard-read", "clipboard-write"]);
    await page.getByRole("button", { name: "Copy link" }).click();
    await page.getByRole("button", { name: "Copied" }).waitFor();
    assert.equal(await page.evaluate(() => navigator.clipboard.readText()), page.url());
    const link = page.url().replace("seed=10", "seed=9");
    await page.goto("about:blank");
    await page.goto(link);
    await tableDone(page);
    assert.deepEqual(await table(page), first, "the same link gives the same table");
    await page.evaluate(() => { location.hash = "#lights=garbage&planners=<b>&draws=-4&protocol=none"; });
    await page.waitForFunction(() => /** @type {HTMLInputElement} */ (document.querySelector("#lights")).value === "10");
  });
});

test("everything can be reached and done with the keyboard alone", async () => {
  await withPage(QUICK, async page => {
    await tableDone(page);
    const focused = () => page.evaluate(() => document.activeElement?.getAttribute("aria-label") ?? document.activeElement?.textContent?.trim() ?? "");
    /** @param {RegExp} name */
    const tabTo = async name => {
      for (let i = 0; i < 90; i += 1) {
        await page.keyboard.press("Tab");
        if (name.test(await focused())) return;
      }
      assert.fail(`Tab does not reach ${name}`);
    };
    await page.keyboard.press("Tab");
    assert.equal(await focused(), "Skip to the content");
    await tabTo(/^Render an object/);
    await page.keyboard.press("Enter");
    await page.getByRole("dialog").waitFor();
    await page.keyboard.press("Escape");
    await page.getByRole("dialog").waitFor({ state: "hidden" });
    assert.match(await focused(), /Render an object/, "focus comes back to the button");
    await tabTo(/^Light directions/);
    const grid = () => page.locator(".dome .grid").first().getAttribute("d");
    const before = await grid();
    await page.keyboard.press("ArrowRight");
    await page.waitForFunction(d => document.querySelector(".dome .grid")?.getAttribute("d") !== d, before);
    await page.keyboard.press("n");
    await page.locator(".dome-tip").waitFor();
    assert.match(await page.locator("#announcements").innerText(), /1 of 100/);
    await page.keyboard.press("Escape");
    await tabTo(/^Relighting direction/);
    const note = () => page.locator(".map-relit .note").innerText();
    const lit = await note();
    await page.keyboard.press("ArrowDown");
    await page.waitForFunction(text => document.querySelector(".map-relit .note")?.textContent !== text, lit);
    await tabTo(/^Step of the run/);
    await page.keyboard.press("Home");
    await stepShown(page, "Step 1 of 6");
    await tabTo(/^Export$/);
    await page.keyboard.press("Enter");
    await page.keyboard.press("Tab");
    const [file] = await Promise.all([page.waitForEvent("download"), page.keyboard.press("Enter")]);
    assert.equal(file.suggestedFilename(), "sphere.csv");
    assert.match(await readFile(await file.path(), "utf8"), /^object,bits,protocol[\s\S]*sphere,16,official,nearest,random/);
  });
});

test("what is exported is what is shown", async () => {
  await withPage(QUICK, async page => {
    await tableDone(page);
    /** @param {string} name */
    const save = async name => {
      await page.locator("#results .menu summary").click();
      const [file] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name, exact: true }).click()]);
      return { name: file.suggestedFilename(), bytes: await readFile(await file.path()) };
    };
    const report = JSON.parse((await save("Table (JSON, as coil eval writes it)")).bytes.toString());
    const rows = await table(page);
    assert.deepEqual(report.results.map((/** @type {{ mae: number }} */ row) => `${row.mae.toFixed(2)}°`), rows.map(row => row[2]));
    const lights = (await save("Lights of this run (.lp)")).bytes.toString().trim().split("\n");
    assert.equal(lights[0], "6");
    assert.match(lights[1], /^\d{3}\.png( -?[\d.e-]+){3}$/);
    const normals = await save("Normals (16-bit PNG)");
    assert.deepEqual([...normals.bytes.subarray(16, 26)], [0, 0, 0, 160, 0, 0, 0, 160, 16, 2], "160×160, 16 bit, RGB");
    for (const map of ["Error map (PNG)", "Picture (PNG)", "Relit picture (PNG)"]) {
      const { bytes } = await save(map);
      assert.equal(bytes.subarray(1, 4).toString(), "PNG", map);
    }
    // The view of another run is held back: until it comes the lights are those of the run before.
    assert.equal(normals.name, "sphere-dc05v-6-ls-normals.png");
    await page.evaluate(() => {
      const post = Worker.prototype.postMessage;
      Worker.prototype.postMessage = function (/** @type {any} */ message, /** @type {any} */ ...more) {
        if (message.kind !== "view") return post.call(this, message, ...more);
        Worker.prototype.postMessage = post;
        addEventListener("release", () => post.call(this, message, ...more), { once: true });
      };
    });
    await page.getByLabel("Planner shown").selectOption("random");
    await page.waitForFunction(() => /is being solved/.test(document.querySelector("#results .menu .note")?.textContent ?? ""));
    const lp = page.locator("#results .menu button", { hasText: "Lights of this run" });
    assert.ok(await lp.isDisabled() && await page.locator(".map-normals .save").isDisabled());
    await page.evaluate(() => dispatchEvent(new Event("release")));
    await page.waitForFunction(() => !(/** @type {HTMLButtonElement} */ (document.querySelector(".map-normals .save")).disabled));
    const random = await save("Lights of this run (.lp)");
    assert.equal(random.name, "sphere-random-6-lights.lp");
    assert.notEqual(random.bytes.toString().trim(), lights.join("\n"));
    const [drawing] = await Promise.all([page.waitForEvent("download"), page.locator("#dome .save").click()]);
    assert.match(await readFile(await drawing.path(), "utf8"), /^<svg [\s\S]*<image /);
  });
});

test("planners by solvers make a matrix, and each cell shows its run", async () => {
  await withPage(QUICK.replace("draws=2", "draws=2&solvers=ls,trimmed,sbr"), async page => {
    await tableDone(page);
    assert.deepEqual(await page.locator("#results thead th").allInnerTexts(), ["Planner", "T", "Least squares", "Trimmed", "Sparse Bayes", "Off by"]);
    const rows = await table(page);
    assert.equal(rows.length, 2);
    for (const row of rows) for (const cell of row.slice(2, 5)) assert.match(cell, /^\d+\.\d\d°±\d+\.\d\d$/);
    await page.getByRole("button", { name: /Random, Trimmed$/ }).click();
    await page.waitForFunction(() => [...document.querySelectorAll("#dome select")].map(s => /** @type {HTMLSelectElement} */ (s).value).join() === "random,trimmed");
    await page.waitForFunction(() => /^mean \d/.test(document.querySelector(".map-expected .note")?.textContent ?? ""));
    assert.ok(await isPainted(page, ".map-expected .frame canvas"), "the solver's own estimate");
  });
});

test("the learned solver runs in pieces, in several workers: the same to the bit as in one, with a preview, and it can be cancelled", async () => {
  await withPage(QUICK, async page => {
    await tableDone(page);
    const got = await page.evaluate(async () => {
      const at = (/** @type {string} */ path) => new URL(path, location.href).href;
      /** @type {typeof import("../pkg/core/coil_ps.js")} */
      const lib = await import(at("pkg/core/coil_ps.js"));
      const { Helpers } = await import(at("helpers.js"));
      const module = WebAssembly.compileStreaming(fetch(at("pkg/core/coil_ps_bg.wasm")));
      await lib.default({ module_or_path: await module });
      lib.loadPixelNetwork(new Uint8Array(await (await fetch(at("models/pixel.onnx"))).arrayBuffer()));
      const capture = lib.Capture.sculpture("blob:3", "red-phenolic", 72);
      while (capture.done < capture.total) capture.takeNext();
      const stack = capture.finish().prepare("official");
      const observations = stack.observe(stack.lights().subarray(0, 18), "nearest");
      const helpers = new Helpers(module);
      // Number 5 of a pixel is what is expected of it among the others: the mean alone would not show that they were compared.
      const row = (/** @type {import("../pkg/core/coil_ps.js").Solution} */ s) => Array.from({ length: 40 }, (_, x) => s.pixel(x + 8, 30)?.[5] ?? NaN);
      const both = (/** @type {import("../pkg/core/coil_ps.js").Solution} */ s) => [s.normals(), s.albedo(), row(s), s.errors() ?? [], s.expectedError ?? NaN, s.mae ?? NaN].join();
      const whole = both(observations.solve("pixel"));
      const inContext = both(observations.solve("context"));
      const tiles = observations.tiles("pixel");
      /** @type {number[]} */
      const levels = [];
      await helpers.solve(tiles, { signal: new AbortController().signal, urgent: true, onLevel: () => levels.push(tiles.done / tiles.total) });
      const cancelled = new AbortController();
      const half = observations.tiles("pixel");
      const end = await helpers.solve(half, { signal: cancelled.signal, urgent: true, onPiece: () => cancelled.abort() })
        .then(() => "finished", (/** @type {Error} */ error) => error.name);
      const again = observations.tiles("pixel");
      await helpers.solve(again, { signal: new AbortController().signal, urgent: true });
      return { finite: row(tiles.solution()).filter(Number.isFinite).length, same: both(tiles.solution()) === whole, corrected: both(tiles.solution("context")) === inContext && inContext !== whole, again: both(again.solution()) === whole, levels, end, left: half.total - half.done, workers: navigator.hardwareConcurrency };
    });
    assert.ok(got.same, "pieces give what one call gives");
    assert.ok(got.corrected, "and corrected by what is around them what one call gives");
    assert.ok(got.finite > 10, `${got.finite} pixels of the row are of the object`);
    // Two levels may become complete at once, where a helper is kept waiting.
    assert.ok(got.levels.length >= 2, `${got.levels}`);
    assert.ok(got.levels[0] < 0.3, `the first preview rests on ${100 * got.levels[0]} % of the pixels`);
    assert.equal(got.end, "AbortError");
    assert.ok(got.left > 0, "it was cancelled in the middle");
    assert.ok(got.again, "the workers are good for the next");
    console.log(`${got.workers} helpers`);
  });
});

test("the learned solvers in the table and on the maps", async () => {
  await withPage(QUICK.replace("draws=2", "draws=1&solvers=ls,pixel,context"), async page => {
    await tableDone(page);
    for (const row of await table(page)) {
      const [plain, learned, corrected] = row.slice(2, 5).map(parseFloat);
      assert.ok(learned < plain && corrected < plain, `least squares ${plain}, learned ${learned}, in context ${corrected}`);
    }
    const early = await page.evaluate(async () => {
      const solver = /** @type {HTMLSelectElement} */ (document.querySelector("#dome select.solver"));
      solver.value = "context";
      solver.dispatchEvent(new Event("change"));
      for (let i = 0; i < 2; i += 1) await new Promise(requestAnimationFrame);
      return !(/** @type {HTMLButtonElement} */ (document.querySelector(".map-normals .save")).disabled);
    });
    assert.ok(!early, "a part of the normals is not saved under the name of all");
    await page.waitForFunction(() => /^from 6 lights/.test(document.querySelector(".map-normals .note")?.textContent ?? ""));
    const [row] = (await table(page)).filter(cells => cells[0] === "DC05 ring + vertical");
    await page.waitForFunction(mae => document.querySelector(".map-errors .note")?.textContent === `mean ${mae}`, row[4]);
    assert.match(await page.locator("#dome .caption").first().innerText(), new RegExp(`Mean error ${row[4].replace("°", "")}`));
  });
});

test("the surface is integrated, turned with keys, and saved as a mesh", async () => {
  await withPage(QUICK, async page => {
    await tableDone(page);
    await page.getByRole("button", { name: "Show in 3-D" }).click();
    await page.waitForFunction(() => document.querySelector(".map-surface canvas")?.getAttribute("width") === "360");
    assert.ok(await isPainted(page, ".map-surface .frame canvas"));
    const canvas = page.locator(".map-surface .frame canvas");
    const picture = () => canvas.evaluate(c => /** @type {HTMLCanvasElement} */ (c).toDataURL());
    const before = await picture();
    await canvas.focus();
    await page.keyboard.press("ArrowRight");
    await page.waitForFunction(old => /** @type {HTMLCanvasElement} */ (document.querySelector(".map-surface canvas")).toDataURL() !== old, before);
    // Another step gives up what is being integrated, and has a surface of its own.
    for (const step of ["4", "5", "6"]) await page.locator("#scrub").fill(step);
    await page.waitForFunction(() => /^from 6/.test(document.querySelector(".map-normals .note")?.textContent ?? "")
      && !(/** @type {HTMLElement} */ (document.querySelector(".map-surface canvas")).hidden));
    await page.locator("#results .menu summary").click();
    for (const [name, beginning] of [["Surface (glTF)", "glTF"], ["Surface (PLY)", "ply\n"], ["Surface (OBJ)", "# "]]) {
      if (!await page.locator("#results .menu[open]").count()) await page.locator("#results .menu summary").click();
      const [file] = await Promise.all([page.waitForEvent("download"), page.getByRole("button", { name }).click()]);
      assert.equal((await readFile(await file.path())).subarray(0, beginning.length).toString(), beginning, name);
    }
  });
});

test("the learned planner runs in the page and shows its gate and its speed", async t => {
  if (!existsSync(join(ROOT, "models/compact/encoder.onnx"))) return t.skip("no trained weights are in models/ yet");
  if (!existsSync(join(TARGET, "page/pkg/policy/coil_ps_bg.wasm"))) {
    if (process.env.CI) throw new Error("the policy's module is missing: run coil serve --build-only");
    return t.skip("the policy's module is not there");
  }
  await withPage(QUICK.replace("random,dc05v", "coil"), async page => {
    /** @type {string[]} */
    const fetched = [];
    page.on("request", request => void fetched.push(new URL(request.url()).pathname));
    await tableDone(page, 120_000);
    for (const network of ["compact", "compact-limited"]) assert.ok(fetched.includes(`/models/${network}/step.onnx`), network);
    const [row] = await table(page);
    assert.equal(row[0], "COIL-PS");
    assert.match(row[2], /^\d+\.\d\d°$/);
    await page.waitForFunction(() => /a step takes it \d+ ms/.test(document.querySelector(".thought")?.textContent ?? ""));
    console.log(await page.locator(".thought").innerText());
    await page.getByLabel("Picture shown").selectOption("gate");
    assert.equal(await page.locator(".map-image .note").innerText(), "magenta: not trusted");
    const [gate] = await Promise.all([page.waitForEvent("download"), page.locator(".map-image .save").evaluate(save => /** @type {HTMLElement} */ (save).click())]);
    assert.equal(gate.suggestedFilename(), "sphere-coil-6-gate.png");
  });
});

test("where the learned planner is not there the page says why, and works with the others", async () => {
  await withPage(QUICK, async page => {
    await page.route("**/build-status.json", route => route.fulfill({ json: { modules: { policy: { state: "failed", message: "no linker" } } } }));
    await page.reload();
    await tableDone(page);
    assert.equal(
      await page.locator(".withheld").innerText(),
      "COIL-PS, the learned planner, is not offered: the module for learned planners was not built: no linker.",
    );
    assert.equal(await page.locator("#planner-coil").count(), 0);
    await page.getByRole("tab", { name: "Rig" }).click();
    await page.locator(".rig-withheld").waitFor();
  });
});

test("screen readers: axe finds no violation, light and dark, wide and narrow, with table, dialog and problem", async () => {
  const axe = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
  /** @param {Page} page @param {string} state */
  const check = async (page, state) => {
    await page.evaluate(axe);
    const violations = await page.evaluate(async () => {
      // @ts-expect-error: axe was put there by the line above
      const result = await window.axe.run(document, { resultTypes: ["violations"] });
      return result.violations.map((/** @type {{ id: string, nodes: { html: string, failureSummary: string }[] }} */ { id, nodes }) => `${id}: ${nodes.map(n => n.html + n.failureSummary).join(" | ")}`);
    });
    assert.deepEqual(violations, [], state);
  };
  for (const [colorScheme, width] of /** @type {const} */ ([["light", 1440], ["dark", 360]])) {
    await withPage(QUICK, async page => {
      await tableDone(page);
      await check(page, `${colorScheme}, ${width} px, table`);
      await page.setInputFiles("#object .file-input", { name: "broken.zip", mimeType: "application/zip", buffer: Buffer.from("not a zip") });
      await page.locator("#problems .problem").waitFor();
      await check(page, `${colorScheme}, ${width} px, problem`);
      await page.getByRole("button", { name: "Render an object…" }).click();
      await check(page, `${colorScheme}, ${width} px, dialog`);
    }, { colorScheme, viewport: { width, height: 900 } });
  }
});

test("a narrow screen shows everything without scrolling sideways", async () => {
  for (const width of [320, 360, 768]) {
    await withPage(QUICK, async page => {
      await tableDone(page);
      assert.ok(await page.evaluate(() => document.documentElement.scrollWidth) <= width, `${width} px`);
      for (const id of ["object", "settings", "dome", "maps", "chart", "results"]) {
        const box = await page.locator(`#${id}`).boundingBox();
        assert.ok(box && box.x >= 0 && box.x + box.width <= width, `${id} at ${width} px`);
      }
      const tops = await page.locator("#view-evaluate > *").evaluateAll(parts => parts.map(part => part.getBoundingClientRect().top));
      if (width < 400) assert.deepEqual(tops, tops.toSorted((a, b) => a - b), "the keyboard goes from the top down");
      const names = (await page.locator(".chart text").allTextContents()).join();
      assert.match(names, /Random/);
      assert.match(names, /DC05 ring\+v/);
      if (width !== 360) return;
      await page.getByRole("button", { name: "Camera’s view" }).tap();
      // The page may still move under a tap while pictures of the last run come in.
      const tip = page.locator(".dome-tip");
      for (let taps = 0; taps < 3 && !await tip.isVisible(); taps += 1) {
        await page.locator(".dome [data-candidate='80']").tap({ force: true });
        await page.waitForTimeout(200);
      }
      assert.match(await tip.innerText(), /81 of 100/);
    }, { viewport: { width, height: 780 }, isMobile: width < 400, hasTouch: width < 400 });
  }
});

test("a worker that can't start is reported with what to do", async () => {
  const { page, context } = await openPage(browser);
  await page.route("**/coil_ps_bg.wasm", route => route.fulfill({ status: 200, contentType: "application/wasm", body: "broken" }));
  await page.goto(server.url);
  await page.locator("#problems .problem").waitFor();
  assert.match(await page.locator("#problems").innerText(), /Reload the page/);
  await context.close();
});

test("a module that breaks in the middle of its work is said to be, and replaced", async () => {
  const { page, context } = await openPage(browser);
  await page.route("**/pkg/core/coil_ps.js", async route => {
    const reply = await route.fetch();
    const broken = `
      const solve = Observations.prototype.solve;
      Observations.prototype.solve = function (name) {
        if (name === "sbr") throw new WebAssembly.RuntimeError("unreachable");
        return solve.call(this, name);
      };`;
    await route.fulfill({ response: reply, body: await reply.text() + broken });
  });
  await page.goto(`${server.url}${QUICK.replace("draws=2", "draws=1&solvers=ls,trimmed,sbr")}`);
  await tableDone(page);
  await page.getByLabel("Solver shown").selectOption("sbr");
  await page.locator("#problems .problem").waitFor();
  assert.match(await page.locator("#problems").innerText(), /not enough memory for it, or coil-ps has a defect/);
  const before = await page.locator(".map-normals .frame canvas").evaluate(c => /** @type {HTMLCanvasElement} */ (c).toDataURL());
  await page.getByLabel("Solver shown").selectOption("trimmed");
  await page.waitForFunction(old => /** @type {HTMLCanvasElement} */ (document.querySelector(".map-normals canvas")).toDataURL() !== old, before);
  await context.close();
});

test("after Cancel the maps go on, and a wrong file gives an interrupted run back", async () => {
  await withPage(LONG, async page => {
    await page.waitForFunction(() => document.querySelectorAll(".strip button").length >= 5);
    await page.locator("#settings .cancel").click();
    await page.getByRole("button", { name: "Show in 3-D" }).click();
    await page.waitForFunction(() => document.querySelector(".map-surface canvas")?.getAttribute("width") === "360");
    await page.locator("#settings").evaluate(form => {
      /** @type {HTMLInputElement} */ (form.querySelector("#draws")).value = "1";
      form.dispatchEvent(new Event("change"));
      /** @type {HTMLFormElement} */ (form).requestSubmit();
    });
    await page.locator("#settings .cancel:enabled").waitFor();
    await page.evaluate(() => scrollTo(0, document.body.scrollHeight));
    await page.setInputFiles("#object .file-input", { name: "broken.zip", mimeType: "application/zip", buffer: Buffer.from("not a zip") });
    await page.locator("#problems .problem").waitFor();
    const box = await page.locator("#problems .problem").boundingBox();
    assert.ok(box && box.y >= 0 && box.y < 780, "the problem is in sight");
    await tableDone(page);
    assert.equal((await table(page)).length, 1);
    await page.getByRole("button", { name: "Dismiss" }).click();
    assert.equal(await page.evaluate(() => document.activeElement?.id), "content");
  }, { viewport: { width: 380, height: 780 } });
});

test("what can't be fetched fails alone, with what to do, and comes with the next run", async () => {
  const { page, context } = await openPage(browser);
  const networks = /models\/(pixel\.onnx|compact)/;
  await page.route(networks, route => route.abort());
  await page.goto(`${server.url}${QUICK.replace("random,dc05v&", "dc05v,coil&solvers=ls,pixel&").replace("draws=2", "draws=1")}`);
  await tableDone(page);
  const [plain, ours] = await table(page);
  assert.match(plain[2], /^\d+\.\d\d°$/);
  assert.match(plain[3], /could not be fetched .* press Run again/);
  assert.match(ours[1], /the network of coil could not be fetched .* press Run again/);
  assert.ok(await isPainted(page, ".map-normals .frame canvas"), "another planner is shown");
  assert.ok(await page.getByRole("button", { name: "Table (CSV)", includeHidden: true }).isEnabled());
  await page.unroute(networks);
  await page.locator("#settings").evaluate(form => /** @type {HTMLFormElement} */ (form).requestSubmit());
  await page.waitForFunction(() => [...document.querySelectorAll("#results tbody tr")].filter(row => /°.*°/.test(row.textContent ?? "")).length === 2);
  await context.close();
});

test("the focus stays where the work is", async () => {
  await withPage(QUICK.replace("draws=2", "draws=1&solvers=ls,trimmed"), async page => {
    await tableDone(page);
    const focused = () => page.evaluate(() => document.activeElement?.getAttribute("data-shows") ?? document.activeElement?.getAttribute("aria-label") ?? document.activeElement?.textContent?.trim());
    for (const shows of ["random trimmed", "dc05v"]) {
      await page.locator(`#results button[data-shows='${shows}']`).press("Enter");
      await page.locator(`#results button[data-shows='${shows}'][aria-pressed=true]`).waitFor();
      assert.equal(await focused(), shows);
    }

    // The surface's first answer is nothing, as of a worker that has just been replaced: the button is there again.
    await page.evaluate(() => {
      const post = Worker.prototype.postMessage;
      Worker.prototype.postMessage = function (/** @type {any} */ message, /** @type {any} */ ...more) {
        if (message.kind !== "surface") return post.call(this, message, ...more);
        Worker.prototype.postMessage = post;
        this.dispatchEvent(new MessageEvent("message", { data: { id: message.id, type: "done", value: null } }));
      };
    });
    const show = page.getByRole("button", { name: "Show in 3-D" });
    await show.press("Enter");
    await page.waitForFunction(() => document.querySelector(".map-surface .empty button")?.getAttribute("aria-disabled") === "false");
    assert.equal(await page.locator(".map-surface .empty").innerText(), "The normals, integrated\nShow in 3-D");
    assert.equal(await focused(), "Show in 3-D");
    await show.press("Enter");
    await page.locator(".map-surface canvas").waitFor();
    assert.match(await focused() ?? "", /^Surface: drag or arrow keys/);

    await page.locator("#lights").fill("20");
    await page.locator("#draws").fill("1000");
    await page.locator("#settings .primary").press("Enter");
    await page.locator("#settings .cancel").press("Enter");
    await page.locator("#settings .cancel:disabled").waitFor();
    assert.equal(await focused(), "Run");

    await page.locator("#object .render").press("Enter");
    await page.locator("#family").selectOption("knot");
    await page.getByRole("dialog").getByRole("button", { name: "Render" }).press("Enter");
    await page.locator("#object .progress .cancel").press("Enter");
    await page.locator("#object .progress").waitFor({ state: "hidden" });
    assert.equal(await focused(), "Render an object…");
  });
});

test("planners that only a link names can be kept and switched off; a garbled look-up is the default", async () => {
  await withPage(QUICK.replace("random,dc05v", "all,ring:35,random").replace("draws=2", "draws=1&lookup=soft"), async page => {
    await tableDone(page);
    assert.equal(await page.locator("#lookup").inputValue(), "nearest");
    const names = async () => (await table(page)).map(row => row[0]).sort();
    /** @param {string} seed */
    const rerun = async seed => {
      await page.locator("#seed").fill(seed);
      await page.locator("#settings .primary").click();
      await page.getByText(`seed ${seed}.`).waitFor();
      await tableDone(page);
    };
    assert.deepEqual(await names(), ["All lights", "Random", "Ring, 35°"]);
    await rerun("2");
    assert.deepEqual(await names(), ["All lights", "Random", "Ring, 35°"]);
    await page.getByLabel("All lights").uncheck();
    await page.getByLabel("Random", { exact: true }).uncheck();
    await rerun("3");
    assert.deepEqual(await names(), ["Ring, 35°"]);
  });
});

test("an object that no run has pictures of yet stands in the dome itself, not the one before; without any the page says so", async () => {
  await withPage(QUICK.replace("red-phenolic", "nonsense"), async page => {
    await page.locator("#problems .problem").waitFor();
    await page.waitForFunction(() => document.querySelector("#object-title")?.textContent === "No object is open");
    assert.ok(await page.locator("#settings .primary").isDisabled());
    await page.evaluate(hash => { location.hash = hash; }, QUICK);
    await tableDone(page);
    const picture = () => page.locator(".dome-object").evaluate(c => /** @type {HTMLCanvasElement} */ (c).toDataURL());
    const sphere = await picture();
    await page.evaluate(hash => { location.hash = hash; }, QUICK.replace("random,dc05v", "ring:x").replace("sphere:1", "bowl:1"));
    await page.waitForFunction(() => document.querySelector("#object-title")?.textContent === "bowl");
    await page.locator("#problems .problem").waitFor();
    await page.waitForFunction(() => (document.querySelector(".dome-object")?.getAttribute("width") ?? "1") !== "1");
    assert.ok(await picture() !== sphere, "the object before it is gone");
    assert.ok(await isPainted(page, ".dome-object"));
  });
});
