// Where a session is kept: the browser's own storage, and a folder of the user's where the browser can. Each file is
// replaced as a whole: `createWritable` writes aside and swaps at `close`. Runs in the rig's worker.

const OWN = "rig-session";

/** The browser's own storage for the one session under way. */
export async function ownFolder() {
  const root = await navigator.storage.getDirectory();
  return root.getDirectoryHandle(OWN, { create: true });
}

/**
 * @param {FileSystemDirectoryHandle} folder
 * @param {{ name: string, bytes: Uint8Array }[]} files written in this order
 */
export async function write(folder, files) {
  for (const { name, bytes } of files) {
    const handle = await folder.getFileHandle(name, { create: true });
    if (!handle.createWritable) { // Safari before 26
      await writeAside(folder, name, bytes);
      continue;
    }
    const stream = await handle.createWritable();
    await stream.write(/** @type {BufferSource} */ (bytes));
    await stream.close();
  }
}

/**
 * @param {FileSystemDirectoryHandle} folder
 * @param {string} name
 * @param {Uint8Array} bytes
 */
async function writeAside(folder, name, bytes) {
  const part = /** @type {any} */ (await folder.getFileHandle(`${name}.part`, { create: true }));
  const access = await part.createSyncAccessHandle();
  access.truncate(0);
  access.write(bytes);
  access.flush();
  access.close();
  await part.move(name);
}

/**
 * @template {{ add: (name: string, bytes: Uint8Array) => void }} F
 * @param {FileSystemDirectoryHandle} folder
 * @param {F} files
 */
export async function read(folder, files) {
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
