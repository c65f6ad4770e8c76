// The serial port in a worker of its own, where the browser has serial ports in workers.

import { Host } from "./host.js";
import { serial } from "./port.js";

/** @type {Host | null} */
let host = null;

/** The same device: ports are objects of their own in each thread. @param {any} port @param {any} info */
function same(port, info) {
  const { usbVendorId, usbProductId } = port.getInfo();
  return usbVendorId === info.usbVendorId && usbProductId === info.usbProductId;
}

/**
 * `take`: is there just one port like this? Then it is served here.
 * @param {MessageEvent<{ type: "take", info: any, rig: MessagePort } | { type: "stop" } | { type: "close" }>} event
 */
self.onmessage = async ({ data }) => {
  if (data.type === "stop") return host?.stop();
  if (data.type === "close") return void host?.close();
  /** @type {any[]} */
  const ports = await serial()?.getPorts().catch(() => []) ?? [];
  const found = ports.filter(port => data.info.usbVendorId && same(port, data.info));
  if (found.length === 1) {
    host = new Host(found[0], data.rig);
    return self.postMessage({ type: "taken" });
  }
  self.postMessage({ type: "refused", rig: data.rig }, { transfer: [data.rig] });
};
