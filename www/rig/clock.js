// The clock of the rig's worker: the core has none, every call is told the time.

export const now = () => performance.now();
export const sleep = (/** @type {number} */ ms) => new Promise(resolve => setTimeout(resolve, ms));
