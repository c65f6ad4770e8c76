// A step of the policy in Chromium, one thread: our module (tract) and onnxruntime-web on the same files, in turn in the same run.
// The directions are compared as well. Needs the built page with its policy module: `./dev wasm`, `npm ci` in www/ and in
// benchmarks/, then `node benchmarks/speed/policy_page.mjs [MODEL]` (default compact).

import { readFile } from "node:fs/promises";
import path from "node:path";

const { launch, openPage, servePage, ROOT } = await import("../../www/tests/support.js");
const SEQUENCES = 40;
const STEPS = 10;

const model = path.join(ROOT, "models", process.argv[2] ?? "compact");
const [encoder, step] = await Promise.all(["encoder", "step"].map(async part => [...await readFile(path.join(model, `${part}.onnx`))]));
const server = await servePage();
const browser = await launch();
const { page } = await openPage(browser);
const ort = path.join(ROOT, "benchmarks/node_modules/onnxruntime-web/dist");
await page.route("**/ort/*", async route => {
  const name = path.basename(new URL(route.request().url()).pathname);
  await route.fulfill({ body: await readFile(path.join(ort, name)), contentType: name.endsWith("wasm") ? "application/wasm" : "text/javascript" });
});
await page.goto(`${server.url}empty`);

const { ours, theirs, apart } = await page.evaluate(async ({ encoder, step, sequences, steps }) => {
  const lib = await import(`${location.origin}/pkg/policy/coil_ps.js`);
  await lib.default({ module_or_path: `${location.origin}/pkg/policy/coil_ps_bg.wasm` });
  const runner = new lib.PolicyRunner(Uint8Array.from(encoder), Uint8Array.from(step));
  const ort = await import(`${location.origin}/ort/ort.wasm.min.mjs`);
  ort.env.wasm.numThreads = 1;
  ort.env.wasm.wasmPaths = `${location.origin}/ort/`;
  const [first, second] = [await ort.InferenceSession.create(Uint8Array.from(encoder)), await ort.InferenceSession.create(Uint8Array.from(step))];
  const shapes = Object.fromEntries(second.inputMetadata.map(input => [input.name, input.shape]));
  const side = runner.info().input;
  const cells = side * side;
  let state = 1;
  const random = () => (state = (state * 48271) % 2147483647) / 2147483647;
  const [ours, theirs] = [0, 1].map(() => Array.from({ length: steps }, () => []));
  let apart = 0;
  for (let s = 0; s < sequences; s += 1) {
    runner.start(new Uint8Array(cells).fill(1), side, side, 90, steps);
    const caches = Object.fromEntries(["keys", "values"].filter(name => name in shapes)
      .map(name => [name, new Float32Array(shapes[name].reduce((a, b) => a * b))]));
    let light = new Float32Array([0, 0, 1]);
    let white = 0;
    for (let i = 0; i < steps; i += 1) {
      // A smooth picture with some noise; a mask of side × side pixels, so that the frame is the picture itself.
      const [kx, ky] = [3 * random(), 3 * random()];
      const rgb = Float32Array.from({ length: 3 * cells }, (_, j) => {
        const p = Math.floor(j / 3);
        return 0.5 + 0.4 * Math.sin(kx * (p % side) / side + ky * Math.floor(p / side) / side) + 0.1 * random();
      });
      if (!white) {
        const grey = Float32Array.from({ length: cells }, (_, p) => (rgb[3 * p] + rgb[3 * p + 1] + rgb[3 * p + 2]) / 3).sort();
        white = grey[Math.floor((cells - 1) * 99 / 100)];
      }
      let start = performance.now();
      const next = runner.observe(light, rgb);
      ours[i].push(performance.now() - start);

      start = performance.now();
      const frame = new Float32Array(3 * cells);
      for (let p = 0; p < cells; p += 1) for (let c = 0; c < 3; c += 1) frame[c * cells + p] = Math.min(2, rgb[3 * p + c] / white);
      const { features } = await first.run({ frame: new ort.Tensor("float32", frame, [1, 3, side, side]) }, ["features"]);
      const inputs = { features, light: new ort.Tensor("float32", light, [1, 3]), reach: new ort.Tensor("float32", [1], [1, 1]) };
      if ("lights" in shapes) inputs.lights = new ort.Tensor("int64", [BigInt(steps)], [1]);
      if ("position" in shapes) inputs.position = new ort.Tensor("int64", [BigInt(i)], [1]);
      for (const [name, cache] of Object.entries(caches)) inputs[name] = new ort.Tensor("float32", cache, shapes[name]);
      const out = await second.run(inputs);
      for (const [name, cache] of Object.entries(caches)) {
        const [, , frames, size] = shapes[name];
        const entries = out[`new_${name}`].data;
        for (let e = 0; e < entries.length / size; e += 1) cache.set(entries.subarray(e * size, (e + 1) * size), (e * frames + i) * size);
      }
      theirs[i].push(performance.now() - start);
      for (let axis = 0; axis < 3; axis += 1) apart = Math.max(apart, Math.abs(out.direction.data[axis] - next[axis]));
      light = next;
    }
  }
  return { ours, theirs, apart };
}, { encoder, step, sequences: SEQUENCES, steps: STEPS });
await browser.close();
server.close();

const median = times => times.toSorted((a, b) => a - b)[times.length >> 1];
const [a, b] = [ours, theirs].map(steps => steps.map(median));
const line = (name, steps) => console.log(`${name.padEnd(22)} ${steps.map(ms => ms.toFixed(2).padStart(6)).join("")}   all ${median(steps).toFixed(2)}`);
console.log(`median ms of steps 1 to ${STEPS}, ${SEQUENCES} sequences, ${path.basename(model)}`);
line("coil (tract)", a);
line("onnxruntime-web", b);
console.log(`ratio ${(median(a) / median(b)).toFixed(2)}; directions differ by at most ${apart.toExponential(1)}`);
if (!(apart < 1e-4)) process.exitCode = 1;
