// How a worker tells the page of an error.

/** Name of an error after which a worker's module can't be trusted any more. */
export const BROKEN = "BrokenModule";

/**
 * Name and message of whatever was thrown. A module that has panicked, or got no more memory, only says "unreachable".
 * @param {unknown} error
 * @returns {{ name: string, message: string }}
 */
export function told(error) {
  if (error instanceof WebAssembly.RuntimeError) {
    return {
      name: BROKEN,
      message: "there was not enough memory for it, or coil-ps has a defect (the browser's console says which). "
        + "Smaller images may work; please report what you did if they don't",
    };
  }
  const { name, message } = error instanceof Error || error instanceof DOMException ? error : new Error(String(error));
  return { name, message };
}
