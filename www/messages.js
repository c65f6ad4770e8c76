// Every message between the page, its worker and the helpers. Types only.
//
// The page asks the worker with a `Request`, the worker answers with `Progress` (any number) and one `Done` or
// `Failed` of the same id. `Abort` ends a request early: it fails with an AbortError.

/**
 * A unit direction towards a light: x right, y up, z to the camera.
 * @typedef {[number, number, number]} Direction
 *
 * What the core offers, and why the learned planners are not part of it; families of sculptures with a line for people, and materials, to render objects from.
 * @typedef {import("./pkg/core/coil_ps.js").Catalogue & { withheld: string, families: [string, string][], materials: string[] }} Catalogue
 *
 * What to compare.
 * @typedef {import("./pkg/core/coil_ps.js").Settings} Settings
 *
 * One light of a run: asked for and used.
 * @typedef {import("./pkg/core/coil_ps.js").StepInfo} StepInfo
 *
 * One row of the table, as `coil eval --json` writes it.
 * @typedef {import("./pkg/core/coil_ps.js").ResultRow} ResultRow
 *
 * A whole table, as `coil eval --json` writes it.
 * @typedef {import("./pkg/core/coil_ps.js").Report} Report
 *
 * RGBA, 8 bit, row by row; transferred, never copied.
 * @typedef {{ width: number, height: number, data: ArrayBuffer }} Picture
 *
 * A file of a dropped or chosen folder, with its path in it.
 * @typedef {{ path: string, file: File }} NamedFile
 *
 * Where an object comes from; enough to open it again.
 * @typedef {{ kind: "sculpture", family: string, seed: number, material: string }
 *   | { kind: "mesh", file: File, material: string }
 *   | { kind: "files", files: NamedFile[], object: string | null }} Source
 *
 * The object that was opened.
 * @typedef {object} ObjectInfo
 * @property {string} name
 * @property {number} bits bits a channel
 * @property {number} images
 * @property {number} width of an image, pixels
 * @property {number} height
 * @property {number} pixels of the mask
 * @property {boolean} truth whether true normals are known
 * @property {string[]} notes what was odd in the files but could be mended
 * @property {string[]} objects names of all objects among the files
 * @property {number} seconds from the request to the stack
 *
 * The stack that a protocol makes of the object.
 * @typedef {object} StackInfo
 * @property {string} protocol
 * @property {number} width
 * @property {number} height
 * @property {number} pixels
 * @property {boolean} truth
 * @property {Direction[]} lights the candidates
 * @property {string[]} names of the images
 * @property {number} reach largest slant, degrees
 *
 * @typedef {{ name: string, step: StepInfo, errors: Record<string, number | null>, thumbnail: Picture }} RunStep
 * name: the planner; errors: MAE in degrees, by solver, without truth what the solver expects it to be; null before three lights
 *
 * The error of a step that was solved after the run: by a solver that takes seconds.
 * @typedef {{ name: string, steps: number, solver: string, error: number | null }} LateError
 *
 * What is shown of one step of one run.
 * @typedef {object} StepView
 * @property {Picture} image the last picture taken
 * @property {Picture | null} normals null before three lights
 * @property {Picture | null} errors null before three lights and without truth
 * @property {Picture | null} expected the solver's own estimate of its error; null where it has none
 * @property {number | null} expectedMean degrees
 * @property {number | null} lampDistance half widths of the object, where the lamps' nearness was seen and taken out
 * @property {number | null} mae degrees
 * @property {number} unknown pixels without a true normal, which count as 90°
 * @property {number} invalid pixels with too few usable values
 * @property {number} solved part of the pixels that these maps are made of, 0…1: less than 1 in a coarse preview
 *
 * A learned planner at work on the pictures that are shown.
 * @typedef {object} Insight
 * @property {Picture | null} gate the last picture with what the network does not trust in magenta; null without gate
 * @property {Direction} next where it wants the next light
 * @property {number[]} milliseconds that it took for each picture
 *
 * The value of the pixel under the pointer.
 * @typedef {object} PixelInfo
 * @property {number} x column in the image
 * @property {number} y row
 * @property {Direction | null} normal
 * @property {number | null} error degrees
 * @property {number | null} expected what the solver expects it to be
 */

/**
 * Requests: what each carries, what it answers, what its progress reports.
 * @typedef {object} Calls
 * @property {{ body: {}, reply: Catalogue, progress: never }} catalogue
 * @property {{ body: { source: Source }, reply: ObjectInfo, progress: { done: number, total: number, what: string } }} open
 * @property {{ body: { protocol: string }, reply: StackInfo, progress: never }} prepare
 * @property {{ body: { settings: Settings }, reply: Report, progress: { done: number, total: number, what?: string, step: RunStep | null, late?: LateError, row: ResultRow[] } }} run
 * @property {{ body: { asked: Direction[], lookup: string, solver: string, scale: number }, reply: StepView, progress: StepView }} view
 * @property {{ body: { planner: string, lights: number }, reply: Insight | null, progress: never }} insight
 * @property {{ body: { asked: Direction[], lookup: string, solvers: string[] }, reply: (number | null)[], progress: never }} score
 * @property {{ body: { light: Direction }, reply: Picture | null, progress: never }} relight
 * @property {{ body: { yaw: number, tilt: number, size: number }, reply: Picture | null, progress: never }} surface
 * the surface is integrated first, where that was not done
 * @property {{ body: { index: number, size: number }, reply: Picture, progress: never }} photo
 * @property {{ body: { x: number, y: number }, reply: PixelInfo | null, progress: never }} pixel
 * @property {{ body: { width: number }, reply: Picture, progress: never }} colours
 * @property {{ body: { what: "normals" | "errors" | "expected" | "image" | "relit" | "surface" | "lp" | "object" | "glb" | "ply" | "obj" }, reply: { bytes: ArrayBuffer, type: string, name: string }, progress: never }} export
 */

/** @typedef {keyof Calls} Kind */
/** @typedef {{ [K in Kind]: { id: number, kind: K } & Calls[K]["body"] }[Kind]} Request */
/** @typedef {{ id: number, kind: "abort" }} Abort */
/** @typedef {{ id: number, type: "progress", value: unknown }} Progress */
/** @typedef {{ id: number, type: "done", value: unknown }} Done */
/** @typedef {{ id: number, type: "failed", error: { name: string, message: string } }} Failed */
/** @typedef {Progress | Done | Failed} Reply */

/**
 * To a helper: the compiled module first; then for each object its mask (a byte a pixel) and its images; the learned
 * solver's network and then pieces (light directions, three numbers each; grey values, image after image, and 1 for each that is saturated, nothing where none is); normals to
 * integrate.
 * @typedef {{ kind: "module", module: WebAssembly.Module }
 *   | { kind: "object", mask: Uint8Array, width: number, height: number }
 *   | { kind: "image", id: number, bytes: File | ArrayBuffer, name: string }
 *   | { kind: "network", id: number, bytes: Uint8Array }
 *   | { kind: "normals", id: number, mask: Uint8Array, width: number, height: number, normals: Float32Array }
 *   | { kind: "piece", id: number, solver: string, lights: Float32Array, values: Float32Array, saturated: Uint8Array, count: number }} HelperRequest
 *
 * From a helper: of an image RGB code values of the mask pixels, 16 bit each; of a piece what `solvePiece` returns;
 * of normals the heights.
 * @typedef {{ kind: "done", id: number, bits: number, result: ArrayBuffer }
 *   | { kind: "failed", id: number, error: { name: string, message: string } }} HelperReply
 */

export {};
