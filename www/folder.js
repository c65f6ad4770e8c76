// Files that were dropped or chosen, with their paths. They are read where they lie; nothing is sent anywhere.

/** @typedef {import("./messages.js").NamedFile} NamedFile */

/** Opening a home folder by mistake must not list a million files. */
const MOST_FILES = 50_000;

/**
 * Files of a drop, folders walked through.
 * @param {DataTransfer} transfer
 * @returns {Promise<NamedFile[]>}
 */
export async function droppedFiles(transfer) {
  // Entries must be taken before the first await: the list is empty afterwards.
  const entries = [...transfer.items].flatMap(item => item.webkitGetAsEntry() ?? []);
  if (!entries.length) return [...transfer.files].map(file => ({ path: file.name, file }));
  /** @type {NamedFile[]} */
  const files = [];
  for (const entry of entries) await walk(entry, files);
  return files;
}

/**
 * Files of a file or folder input.
 * @param {FileList} list
 * @returns {NamedFile[]}
 */
export function chosenFiles(list) {
  return [...list].map(file => ({ path: file.webkitRelativePath || file.name, file }));
}

/**
 * @param {FileSystemEntry} entry
 * @param {NamedFile[]} files
 */
async function walk(entry, files) {
  if (files.length >= MOST_FILES) {
    throw new Error(`more than ${MOST_FILES} files: choose the folder of one object or of a DiLiGenT release`);
  }
  // Chromium has no constructors of these names to ask with instanceof.
  if (entry.isFile) {
    /** @type {File} */
    const file = await new Promise((resolve, reject) => /** @type {FileSystemFileEntry} */ (entry).file(resolve, reject));
    files.push({ path: entry.fullPath.replace(/^\//, ""), file });
  } else {
    const reader = /** @type {FileSystemDirectoryEntry} */ (entry).createReader();
    for (;;) {
      /** @type {FileSystemEntry[]} */
      const batch = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
      if (!batch.length) break; // a reader gives at most 100 at a time
      for (const child of batch) await walk(child, files);
    }
  }
}
