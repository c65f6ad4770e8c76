// Reads an object from files: the small ones here, the images in parallel by helpers.

/** @typedef {import("./messages.js").NamedFile} NamedFile */
/** @typedef {import("./helpers.js").Helpers} Helpers */

/** Files of an object that are read as a whole. */
const SMALL = /(^|\/)(mask\.png|[^/]+\.(txt|mat))$/i;

/**
 * @param {typeof import("./pkg/core/coil_ps.js")} lib the build to read with
 * @param {NamedFile[]} files
 * @param {string | null} wanted name of the object; null for the first
 * @param {Helpers} helpers
 * @param {AbortSignal} signal
 * @param {(progress: { done: number, total: number, what: string }) => void} progress
 */
export async function readObject(lib, files, wanted, helpers, signal, progress) {
  progress({ done: 0, total: 1, what: "looking at the files" });
  const starting = helpers.start();
  const archive = files.length === 1 && /\.zip$/i.test(files[0].path) ? files[0].file : null;
  const byPath = new Map(archive ? [] : files.map(({ path, file }) => [path, file]));
  const listed = archive ? lib.ObjectFiles.zip(await bytesOf(archive), archive.name) : new lib.ObjectFiles();
  for (const path of byPath.keys()) listed.list(path);
  const objects = listed.names();
  if (!objects.length) throw new Error(`${archive?.name ?? "what was opened"} has no folder with light_directions.txt`);
  const folder = listed.folderOf(wanted ?? "");
  for (const [path, file] of byPath) {
    const inside = folder === "" || path.startsWith(`${folder}/`);
    if (inside && SMALL.test(path)) listed.add(path, await bytesOf(file));
    signal.throwIfAborted();
  }
  const header = listed.header(folder);
  const { images, width, height, notes } = header;
  const total = images.length;
  await starting;
  let done = 0;
  progress({ done, total, what: "image" });
  const sources = images.map(name => ({ name, bytes: () => byPath.get(name) ?? /** @type {ArrayBuffer} */ (listed.bytes(name).buffer) }));
  await helpers.decode(sources, { mask: header.mask(), width, height }, signal, (k, bits, pixels) => {
    header.put(k, bits, pixels);
    done += 1;
    progress({ done, total, what: "image" });
  });
  listed.free();
  const object = header.assemble();
  const variant = wanted === "bear76" ? object.bear76() : undefined;
  if (!variant) return { object, notes, objects };
  object.free();
  return { object: variant, notes: [], objects };
}

/** @param {File} file */
async function bytesOf(file) {
  return new Uint8Array(await file.arrayBuffer());
}
