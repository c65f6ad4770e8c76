// Least squares in WebAssembly (SIMD128), 57,721 pixels × 10 lights, one thread: the peer of
// `cargo bench --bench least_squares`. Needs the built page: `./dev wasm`, then `node benchmarks/speed/least_squares.mjs`.
// Times `Session.normals`, which also copies the normals out of the module's memory. The garbage that this leaves is collected
// between the solves: else every second one waits for it.

import { readFile } from "node:fs/promises";
import path from "node:path";
import { setFlagsFromString } from "node:v8";
import { runInNewContext } from "node:vm";

const target = process.env.CARGO_TARGET_DIR ?? path.join(import.meta.dirname, "../../target");
const pkg = path.join(target, "page/pkg/core");
const { initSync, Session } = await import(path.join(pkg, "coil_ps.js"));
initSync({ module: await readFile(path.join(pkg, "coil_ps_bg.wasm")) });

const [width, height, lights] = [197, 293, 10]; // 57,721 pixels
const session = new Session(new Uint8Array(width * height).fill(1), width, height, "dc05", lights, new Float32Array(), 40, 1);
let state = 1;
const random = () => (state = (state * 48271) % 2147483647) / 2147483647;
for (let light; (light = session.next()); )
  session.observe(light, Float32Array.from({ length: 3 * width * height }, random));

setFlagsFromString("--expose-gc");
const collect = runInNewContext("gc");
const times = [];
for (let i = 0; i < 200; i++) {
  collect();
  const start = performance.now();
  session.normals("ls");
  times.push(performance.now() - start);
}
times.sort((a, b) => a - b);
console.log(`wasm: median ${times[100].toFixed(2)} ms, fastest ${times[0].toFixed(2)} ms`);
