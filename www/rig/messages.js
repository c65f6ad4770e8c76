// Every message between the rig view and its worker. Types only.
//
// The view asks with a `Request`; the worker answers with `Done` or `Failed` of the same id, and tells by itself what
// happens (`Told`).

/**
 * @typedef {import("../messages.js").Picture} Picture
 * @typedef {import("../messages.js").Direction} Direction
 * @typedef {import("../pkg/core/coil_ps.js").CaptureSettings} CaptureSettings
 * @typedef {import("../pkg/core/coil_ps.js").Outline} Outline
 * @typedef {import("../pkg/core/coil_ps.js").Measured} Measured
 * @typedef {import("../pkg/core/coil_ps.js").FrameQuality} FrameQuality
 * @typedef {import("../pkg/core/coil_ps.js").LightTaken} LightTaken
 *
 * A line of the console, or a failure.
 * @typedef {{ kind: string, text: string }} Said
 *
 * Where exposures come from. A watched folder is looked into by the worker; the view is asked for the others.
 * @typedef {{ kind: "sim" } | { kind: "webcam" } | { kind: "files", black: number, white: number | null }
 *   | { kind: "folder", folder: FileSystemDirectoryHandle, black: number, white: number | null }} Camera
 *
 * An exposure: pictures of a webcam to average, or a file.
 * @typedef {{ bitmaps: ImageBitmap[], milliseconds: number } | { bytes: ArrayBuffer, milliseconds: number }} Shot
 *
 * The drawing as it is now.
 * @typedef {object} Sketch
 * @property {Picture} picture the preview
 * @property {number} width of the whole picture, pixels
 * @property {number} height
 * @property {number} pixels in the mask
 * @property {number | null} level of the threshold
 * @property {FrameQuality | null} quality null without a mask
 *
 * What is done to the mask; coordinates in pixels of the whole picture.
 * @typedef {{ kind: "threshold", level: number | null } | { kind: "polygon", corners: number[], add: boolean }
 *   | { kind: "stroke", from: [number, number], to: [number, number], radius: number, add: boolean } | { kind: "clear" }} Stroke
 *
 * A session that is stored and not complete.
 * @typedef {{ taken: number, lights: number, simulated: boolean }} Stored
 *
 * What the arm does; angles in degrees.
 * @typedef {"home" | "unlock" | "here" | "hold" | "resume" | "release" | "reset" | "jogCancel"} Plain
 * @typedef {{ name: Plain } | { name: "goto" | "jog", azimuth: number, slant: number } | { name: "light", brightness: number }
 *   | { name: "raw", line: string }} Order
 *
 * @typedef {object} Calls
 * @property {{ body: { arm: string | null, pace: number }, reply: { limits: number[], fitted: boolean, session: Stored | null, folder: FileSystemDirectoryHandle | null } }} start
 *   folder: where the session lay, before a reload; fitted: whether the arm goes by `arm`, which may be unreadable
 * @property {{ body: { rig: MessagePort | null }, reply: void }} connect without a port: the simulated arm
 * @property {{ body: {}, reply: void }} disconnect
 * @property {{ body: { sent: boolean }, reply: void }} stop sent: its bytes went out already
 * @property {{ body: { order: Order }, reply: { projected: number } }} order
 * @property {{ body: { mode: "auto" | "one", settings: CaptureSettings, camera: Camera, stored: boolean }, reply: void }} begin
 *   stored: goes on with the stored session
 * @property {{ body: {}, reply: void }} pause
 * @property {{ body: {}, reply: void }} discard deletes the session that this browser keeps
 * @property {{ body: { shot: Shot | null, reason: string }, reply: void }} exposed null: there is none, for that reason
 * @property {{ body: { shot: Shot, camera: Camera }, reply: Sketch }} look
 * @property {{ body: { stroke: Stroke }, reply: Sketch }} draw
 * @property {{ body: {}, reply: Outline }} findOutline
 * @property {{ body: { points: number[] }, reply: Outline }} fitOutline
 * @property {{ body: { outline: Outline }, reply: Measured }} measure
 * @property {{ body: {}, reply: { mount: number[], before: number, after: number, count: number, arm: string } }} fit
 * @property {{ body: {}, reply: void }} unfit the arm as it is drawn
 * @property {{ body: { azimuth: number, slant: number }, reply: Picture | null }} relight
 * @property {{ body: { folder: FileSystemDirectoryHandle | null, settings: CaptureSettings },
 *   reply: { session: Stored | null, shown: { object: string, taken: number, lights: number } | null } }} keep
 *   also saves to that folder; a session that lies there is shown, and goes on with `begin`
 * @property {{ body: {}, reply: ArrayBuffer }} zip
 *
 * @typedef {keyof Calls} Kind
 * @typedef {{ [K in Kind]: { id: number, kind: K } & Calls[K]["body"] }[Kind]} Request
 *
 * @typedef {{ type: "done", id: number, value: any } | { type: "failed", id: number, error: { name: string, message: string } }} Answer
 *
 * The arm and the capture, whenever something changed.
 * @typedef {{ type: "state", shown: Record<string, any>, said: Said[], findings: Said[] | null, wanted: boolean,
 *   mode: "idle" | "auto" | "one", preparing: boolean, progress: string | null, target: Direction | null,
 *   folder: string | null }} State
 *
 * What a light brought.
 * @typedef {{ type: "taken", lights: LightTaken[], photo: Picture | null, normals: Picture | null, relit: Picture | null,
 *   error: number | null, notes: string[] }} Taken
 *
 * @typedef {{ type: "expose", number: number, index: number, milliseconds: number, count: number }} Expose
 * @typedef {{ type: "ended", done: boolean, session: Stored | null }} Ended
 * @typedef {{ type: "help", text: string }} Help
 * @typedef {{ type: "problem", message: string }} Problem
 * @typedef {State | Taken | Expose | Ended | Help | Problem} Told
 */

export {};
