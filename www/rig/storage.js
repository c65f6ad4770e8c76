// Where a session is kept: the browser's own storage, and a folder of the user's where the browser can. Each file is
// replaced as a whole: `createWritable` writes aside and swaps at `close`. Runs in the rig's worker.

const OWN = "rig-session";
/** Names of a session's files: a folder of the user's may hold others. */
const NAMES = /^(session\.json|mask\.png|\d{3,4}\.png|lights\.lp|(filenames|light_directions|light_intensities)\.txt|Normal_(gt|est)\.mat)$/;

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
    if (handle.kind !== "file" || !NAMES.test(name)) continue;
    files.add(name, new Uint8Array(await (await handle.getFile()).arrayBuffer()));
  }
  return files;
}

/**
 * Copies a session, its record last.
 * @param {FileSystemDirectoryHandle} from
 * @param {FileSystemDirectoryHandle} to
 */
export async function copy(from, to) {
  const files = /** @type {{ name: string, bytes: Uint8Array }[]} */ ([]);
  await read(from, { add: (name, bytes) => void files.push({ name, bytes }) });
  await write(to, files.sort((a, b) => Number(a.name === "session.json") - Number(b.name === "session.json")));
}

/** @param {FileSystemDirectoryHandle} folder */
export async function holdsSession(folder) {
  for await (const name of /** @type {any} */ (folder).keys()) if (name === "session.json") return true;
  return false;
}

/** @param {FileSystemDirectoryHandle} folder */
export async function clear(folder) {
  const names = [];
  for await (const name of /** @type {any} */ (folder).keys()) names.push(name);
  for (const name of names) await folder.removeEntry(name);
}

const DATABASE = "coil-ps-rig";
const STORE = "folders";

/** @param {IDBTransactionMode} mode @param {(store: IDBObjectStore) => IDBRequest<any>} ask @returns {Promise<any>} */
async function database(mode, ask) {
  const result = (/** @type {IDBRequest<any>} */ request) => new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
  const opening = indexedDB.open(DATABASE, 1);
  opening.onupgradeneeded = () => opening.result.createObjectStore(STORE);
  const opened = /** @type {IDBDatabase} */ (await result(opening));
  try {
    return await result(ask(opened.transaction(STORE, mode).objectStore(STORE)));
  } finally {
    opened.close();
  }
}

/** Keeps the folder of the session under way over a reload, where the browser can; null: there is none. @param {FileSystemDirectoryHandle | null} folder */
export async function remember(folder) {
  await database("readwrite", store => folder ? store.put(folder, OWN) : store.delete(OWN)).catch(() => {});
}

/** @returns {Promise<FileSystemDirectoryHandle | null>} */
export async function remembered() {
  return await database("readonly", store => store.get(OWN)).catch(() => null) ?? null;
}
