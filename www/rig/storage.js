// Where a session is kept: a folder of the user's where the browser can, else its own storage. Each file is replaced
// as a whole: `createWritable` writes aside and swaps at `close`.

import { SessionFiles } from "../pkg/core/coil_ps.js";

const OWN = "rig-session";

/** The browser's own storage for the one session under way. */
export async function ownFolder() {
  const root = await navigator.storage.getDirectory();
  return root.getDirectoryHandle(OWN, { create: true });
}

/** A folder that the user chooses; null where the browser has no such dialog, or none was chosen. */
export async function chosenFolder() {
  const choose = /** @type {any} */ (window).showDirectoryPicker;
  if (!choose) return null;
  try {
    return /** @type {FileSystemDirectoryHandle} */ (await choose({ id: "rig-session", mode: "readwrite" }));
  } catch (error) {
    if (/** @type {Error} */ (error).name === "AbortError") return null;
    throw error;
  }
}

/**
 * @param {FileSystemDirectoryHandle} folder
 * @param {import("../pkg/core/coil_ps.js").SessionFile[]} files written in this order
 */
export async function write(folder, files) {
  for (const file of files) {
    const handle = await folder.getFileHandle(file.name, { create: true });
    const stream = await handle.createWritable();
    await stream.write(/** @type {BufferSource} */ (file.bytes));
    await stream.close();
    file.free();
  }
}

/** @param {FileSystemDirectoryHandle} folder */
export async function read(folder) {
  const files = new SessionFiles();
  for await (const [name, handle] of /** @type {any} */ (folder).entries()) {
    if (handle.kind !== "file" || !/^[\w.]+$/.test(name)) continue;
    files.add(name, new Uint8Array(await (await handle.getFile()).arrayBuffer()));
  }
  return files;
}

/** @param {FileSystemDirectoryHandle} folder */
export async function clear(folder) {
  const names = [];
  for await (const name of /** @type {any} */ (folder).keys()) names.push(name);
  for (const name of names) await folder.removeEntry(name);
}
