// The connection: ports to choose from, who holds the chosen one, and Stop, which goes straight to it.

import { find, html, set } from "../svg.js";
import { Host } from "./host.js";
import { explain, portName, serial, unsupported } from "./port.js";

/**
 * @param {HTMLElement} root
 * @param {import("./rig.js").Panel} panel
 * @param {ReturnType<typeof import("./status.js").mountStatus>} status
 * @param {ReturnType<typeof import("./camera_panel.js").mountCamera>} camera
 */
export function mountConnection(root, { client, fields, say, failed }, status, camera) {
  const { $, select, on } = fields;
  /** Another thread's, or this one's: what holds the serial port. @type {{ stop: () => void, close: () => void } | null} */
  let host = null;
  const portWorker = serial() ? new Worker(new URL("port-worker.js", import.meta.url), { type: "module", name: "coil-ps-port" }) : null;
  /** @type {any[]} */
  let remembered = [];

  /** @param {string} text */
  function help(text) {
    $(".rig-help-text").textContent = text;
    find(root, "dialog", HTMLDialogElement).showModal();
  }

  /** @param {any} [chosen] */
  async function listPorts(chosen) {
    remembered = serial() ? await serial().getPorts() : [];
    select(".rig-port").replaceChildren(
      html("option", { value: "simulated" }, "Simulated arm"),
      ...remembered.map((p, i) => html("option", { value: `port${i}`, selected: p === chosen }, portName(p))),
      html("option", { value: "choose" }, "Choose a serial port…"),
    );
  }

  /** Gives the port to a worker of its own where the browser can, else serves it here. @param {any} raw @returns {Promise<MessagePort>} */
  async function serve(raw) {
    const { port1, port2 } = new MessageChannel();
    const answer = portWorker && await new Promise(resolve => {
      portWorker.onmessage = ({ data }) => resolve(data);
      portWorker.onerror = () => resolve(null);
      portWorker.postMessage({ type: "take", info: raw.getInfo(), rig: port1 }, [port1]);
    });
    if (answer?.type === "taken") {
      host = { stop: () => portWorker?.postMessage({ type: "stop" }), close: () => portWorker?.postMessage({ type: "close" }) };
    } else {
      host = new Host(raw, answer?.rig ?? port1);
    }
    set(root, { "data-port": answer?.type === "taken" ? "worker" : "page" });
    return port2;
  }

  async function connect() {
    say("");
    const choice = select(".rig-port").value;
    let raw = null;
    try {
      if (choice.startsWith("port")) raw = remembered[Number(choice.slice(4))];
      else if (choice === "choose") {
        const missing = unsupported();
        if (missing) return say(missing);
        raw = await serial().requestPort();
        await listPorts(raw);
      }
    } catch (error) {
      if (/** @type {Error} */ (error).name === "NotFoundError") return help("No port was chosen. If yours was not in the list:");
      return say(explain(error));
    }
    try {
      host = null;
      const port = raw ? await serve(raw) : null;
      await client.call("connect", { rig: port }, port ? [port] : []);
    } catch (error) {
      say(explain(error));
    }
  }

  function stop() {
    const sent = host !== null && status.state?.shown.phase !== "closed";
    // Straight to the port: two bytes, nothing before them and no worker to wait for.
    if (sent) host?.stop();
    camera.forget();
    $(".rig-ask").hidden = true;
    client.call("stop", { sent }).catch(failed);
  }

  on(".rig-stop", stop);
  document.addEventListener("keydown", event => {
    if (event.key === "Escape" && !root.hidden && status.state?.shown.phase !== "closed") stop();
  });
  on(".rig-connect", () => {
    const { state } = status;
    return state?.wanted || state && state.shown.phase !== "closed" ? client.call("disconnect", {}).catch(failed) : connect();
  });

  return { help, listPorts, close: () => host?.close() };
}
