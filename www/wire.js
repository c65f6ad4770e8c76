// What both workers need around their messages: what must be there, pictures that can be sent, and what moves with them.

/** @typedef {import("./messages.js").Picture} Picture */
/** @typedef {import("./pkg/core/coil_ps.js").Picture} CorePicture */

/**
 * @template T
 * @param {T | null | undefined} value
 * @param {string} otherwise
 * @returns {T}
 */
export function needed(value, otherwise) {
  if (value === null || value === undefined) throw new Error(otherwise);
  return value;
}

/**
 * A picture of the core as one that can be transferred.
 * @param {CorePicture} picture
 * @returns {Picture}
 */
export function take(picture) {
  const { width, height, rgba } = picture;
  picture.free();
  return { width, height, data: /** @type {ArrayBuffer} */ (rgba.buffer) };
}

/** @param {CorePicture | null | undefined} picture */
export function optional(picture) {
  return picture ? take(picture) : null;
}

/** Buffers of the pictures in a message: they are transferred. @param {unknown} value @returns {Transferable[]} */
export function buffers(value) {
  if (value instanceof ArrayBuffer) return [value];
  if (value === null || typeof value !== "object" || ArrayBuffer.isView(value)) return [];
  return Object.values(value).flatMap(buffers);
}
