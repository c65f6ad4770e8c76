// The camera that is chosen: a webcam, files, or a folder to watch; its exposures, and the picture to draw the mask on.

import { html } from "../svg.js";
import { Webcam, chooseFolder, chooseImages, explainCamera } from "./camera.js";
import { MaskPanel } from "./mask.js";
import { explain } from "./port.js";

/**
 * @param {HTMLElement} root
 * @param {import("./rig.js").Panel} panel
 */
export function mountCamera(root, { page, client, fields, say, failed }) {
  const { $, input, select, button, number, on } = fields;
  const webcam = new Webcam();
  $(".rig-video").append(webcam.video);
  const mask = new MaskPanel(client, failed);
  $(".rig-real").append(mask.element);
  /** The folder that is watched. @type {FileSystemDirectoryHandle | null} */
  let watched = null;
  /** Files that were chosen and wait for their exposure. @type {File[]} */
  let given = [];
  let gave = () => {};

  /** @returns {import("./messages.js").Camera} */
  function chosen() {
    const kind = select(".rig-camera").value;
    const levels = { black: number(".rig-black") || 0, white: Number.isFinite(number(".rig-white")) ? number(".rig-white") : null };
    if (kind === "folder") {
      if (!watched) throw new Error("Choose the folder that the camera saves to.");
      return { kind, folder: watched, ...levels };
    }
    if (kind === "files") return { kind, ...levels };
    return kind === "webcam" ? { kind } : { kind: "sim" };
  }

  function exposures() {
    const list = input(".rig-exposures").value.split(/[\s,;]+/).filter(Boolean).map(Number);
    // A webcam whose exposure can't be set takes one picture.
    return select(".rig-camera").value === "webcam" && !webcam.exposureRange() ? list.slice(-1) : list;
  }

  /** One picture, for the drawing or an exposure. @param {number} milliseconds @returns {Promise<import("./messages.js").Shot | null>} */
  async function picture(milliseconds) {
    if (select(".rig-camera").value === "webcam") return webcam.take(milliseconds, Math.max(1, number(".rig-average") || 1));
    if (!given.length) given = await chooseImages() ?? [];
    const file = given.shift();
    return file ? { bytes: await file.arrayBuffer(), milliseconds } : null;
  }

  /** @param {import("./messages.js").Expose} asked */
  async function expose({ number: k, index, milliseconds, count }) {
    try {
      if (select(".rig-camera").value === "files" && !given.length) {
        // A dialog needs a click.
        const what = k ? `light ${k}` : "the dark frame";
        button(".rig-give").textContent = `Choose ${count - index === 1 ? "the image" : `the ${count - index} images`} of ${what}`;
        $(".rig-ask").hidden = false;
        button(".rig-give").focus();
        page.announce(`Images of ${what} are needed`);
        await new Promise(resolve => {
          gave = () => {
            if (given.length <= count - index) return resolve(null);
            say(`${given.length} images were chosen where ${what} needs ${count - index}: choose again.`);
            given = [];
          };
        });
        $(".rig-ask").hidden = true;
      }
      const shot = await picture(milliseconds);
      await client.call("exposed", { shot, reason: "no image was given" }, shot && "bitmaps" in shot ? shot.bitmaps : []);
    } catch (error) {
      await client.call("exposed", { shot: null, reason: explainCamera(error) }).catch(failed);
    }
  }

  on(".rig-give", async () => {
    given = await chooseImages() ?? [];
    if (given.length) gave();
  });

  select(".rig-camera").addEventListener("change", () => {
    const kind = select(".rig-camera").value;
    for (const part of root.querySelectorAll(".rig-of")) {
      /** @type {HTMLElement} */ (part).hidden = !(/** @type {HTMLElement} */ (part).dataset.camera?.split(" ").includes(kind));
    }
    $(".rig-real").hidden = kind === "sim";
    $(".rig-watch").hidden = kind !== "folder";
    given = [];
    if (kind === "webcam") listCameras().catch(error => say(explainCamera(error)));
    else webcam.close();
  });
  async function listCameras() {
    const missing = Webcam.unsupported();
    if (missing) return say(missing);
    const chosen = webcam.track?.getSettings().deviceId ?? "";
    const devices = await Webcam.devices();
    select(".rig-device").replaceChildren(
      html("option", { value: "" }, "Any camera"),
      ...devices.filter(d => d.deviceId).map((d, i) => html("option", { value: d.deviceId, selected: d.deviceId === chosen }, d.label || `Camera ${i + 1}`)),
    );
  }
  on(".rig-open-camera", async () => {
    say("");
    try {
      await webcam.open(select(".rig-device").value);
      await listCameras();
      const { held, free } = await webcam.lock();
      const range = webcam.exposureRange();
      const { width, height } = webcam.track?.getSettings() ?? {};
      $(".rig-locks").textContent = [
        `${width} × ${height} pixels.`,
        held.length ? `Held still: ${held.join(", ")}.` : "",
        free.length ? `This camera does not let the page hold ${free.join(", ")}: switch off what changes by itself in its own program.` : "",
        range ? `Exposures from ${range.least} to ${range.most} ms can be set.` : "Its exposure time can't be set: one exposure is taken for each light.",
        "Its pictures are taken as sRGB; normals from it are rough.",
      ].filter(Boolean).join(" ");
    } catch (error) {
      say(explainCamera(error));
    }
  });
  on(".rig-watch", async () => {
    try {
      watched = await chooseFolder("read", "rig-camera");
      if (watched) button(".rig-watch").textContent = `Watching “${watched.name}”`;
      else say("This browser can't watch folders, or none was chosen. Images can be chosen for each light instead.");
    } catch (error) {
      say(explain(error));
    }
  });
  on(".rig-look", async () => {
    say("");
    try {
      const kind = select(".rig-camera").value;
      const milliseconds = exposures().at(-1) ?? 10;
      const shot = kind === "folder" ? await chooseImages().then(async files => files && { bytes: await files[0].arrayBuffer(), milliseconds }) : await picture(milliseconds);
      given = [];
      const from = kind === "webcam" ? /** @type {const} */ ({ kind }) : { .../** @type {any} */ (chosen()), folder: null };
      if (shot) mask.show(await client.call("look", { shot, camera: from }, "bitmaps" in shot ? shot.bitmaps : []));
    } catch (error) {
      say(explainCamera(error));
    }
  });
  input(".rig-mirror").addEventListener("change", () => { mask.sphere = input(".rig-mirror").checked; });

  return {
    chosen, exposures, expose,
    /** The mirror sphere's, in the pictures; null: it was not marked. */
    get outline() { return mask.outline; },
    /** Drops the files that wait for their exposure. */
    forget() { given = []; },
    close: () => webcam.close(),
  };
}
