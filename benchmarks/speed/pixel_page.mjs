// The learned solver in the page, in Chromium: time to the first preview and to the whole of pot1 (57,721 pixels) under ten
// lights, in as many workers as the machine has processors. Needs the built page and the shared data: `./dev wasm`,
// `npm ci` in www/, then `node benchmarks/speed/pixel_page.mjs`.

import path from "node:path";

const { launch, openPage, servePage, sharedData, tableDone } = await import("../../www/tests/support.js");
const TIMES = 5;

const data = sharedData({ skip: (/** @type {string} */ why) => console.log(why) });
if (!data) process.exit(1);
const server = await servePage();
const browser = await launch();
const { page } = await openPage(browser);
await page.goto(`${server.url}#planners=dc05v&lights=3&draws=1&object=sphere:1&material=red-phenolic`);
await tableDone(page);
await page.evaluate(() => {
  document.querySelector("#object .folder-input").addEventListener("change", event => {
    window.chosen = [...event.target.files].map(file => ({ path: file.webkitRelativePath, file }));
    event.stopImmediatePropagation(); // the page itself need not open it
  }, { capture: true });
});
await page.setInputFiles("#object .folder-input", path.join(data, "DiLiGenT/pmsData_crop_8bit/pot1PNG"));
const { pixels, workers, times } = await page.evaluate(async count => {
  const { Engine } = await import(new URL("engine.js", location.href).href);
  const engine = new Engine();
  const { pixels } = await engine.call("open", { source: { kind: "files", files: window.chosen, object: null } });
  const { lights } = await engine.call("prepare", { protocol: "official" });
  const asked = lights.filter((_, i) => i % 10 === 0);
  const times = [];
  for (let i = 0; i < count; i += 1) {
    const start = performance.now();
    let preview = null;
    const onProgress = () => { preview ??= performance.now() - start; };
    await engine.call("view", { asked, lookup: "nearest", solver: "pixel", scale: 30 }, { onProgress });
    times.push({ preview, whole: performance.now() - start });
  }
  return { pixels, workers: navigator.hardwareConcurrency, times };
}, TIMES);
await browser.close();
server.close();

const best = key => Math.min(...times.map(time => time[key]));
const first = times[0];
console.log(`${pixels} pixels × 10 lights, ${workers} workers, ${TIMES} times`);
console.log(`preview: best ${best("preview").toFixed(0)} ms, first time (with the network's download) ${first.preview.toFixed(0)} ms`);
console.log(`whole:   best ${best("whole").toFixed(0)} ms, first time ${first.whole.toFixed(0)} ms`);
