// The npm package that wasm-pack makes (pkg/): typed, complete, and it plans and solves outside a browser.
// Run by `./dev test wasm-pack`.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import test from "node:test";

const pkg = new URL("../pkg/", import.meta.url);
const text = name => readFile(new URL(name, pkg), "utf8");

test("package.json names the crate's version and files that exist", async () => {
  const manifest = JSON.parse(await text("package.json"));
  const cargo = await readFile(new URL("../Cargo.toml", import.meta.url), "utf8");
  assert.equal(manifest.name, "coil-ps");
  assert.equal(manifest.version, /^version = "(.*)"/m.exec(cargo)?.[1]);
  assert.equal(manifest.license, "MIT OR Apache-2.0");
  for (const file of [manifest.main, manifest.types, ...manifest.files]) assert.ok((await text(file)).length > 0, file);
});

test("every exported class and function has types and a description", async () => {
  const types = await text("coil_ps.d.ts");
  // what follows is wasm-bindgen's own: how to start the module
  const ours = types.slice(0, types.indexOf("export type InitInput"));
  assert.doesNotMatch(ours, /: any\b/);
  const exported = [...ours.matchAll(/^(.*)\n^export (?:class|function) (\w+)/gm)];
  assert.ok(exported.length >= 8, `${exported.length} exports`);
  const undescribed = exported.filter(([, before]) => !before.trimEnd().endsWith("*/")).map(([, , name]) => name);
  assert.deepEqual(undescribed, []);
});

test("a session plans and solves a tilted plane", async () => {
  const { initSync, Session } = await import(new URL("coil_ps.js", pkg).href);
  initSync({ module: await readFile(new URL("coil_ps_bg.wasm", pkg)) });
  const normal = [0.36, -0.48, 0.8], albedo = 0.5, pixels = 4, lights = 6;
  const session = new Session(new Uint8Array(pixels).fill(1), 2, 2, "dc05", lights, new Float32Array(), 40, 1);
  let pictures = 0;
  for (let light; (light = session.next()); pictures++) {
    const shading = albedo * normal.reduce((sum, n, axis) => sum + n * light[axis], 0);
    session.observe(light, new Float32Array(3 * pixels).fill(shading));
  }
  assert.equal(pictures, lights);
  const normals = session.normals("ls");
  assert.equal(normals.length, 3 * pixels);
  normals.forEach((value, i) => assert.ok(Math.abs(value - normal[i % 3]) < 1e-5, `component ${i} is ${value}`));
});
