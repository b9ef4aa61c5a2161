/**
 * Opens the page's own camera for an input.
 *
 * @import { Opened } from "./own_input.js"
 * @import { InputText } from "./texts.js"
 */
import { mediaDevices } from "./own_input.js";

/** @param {InputText} input @returns {Promise<Opened>} */
export async function openCamera(input) {
  const devices = mediaDevices();
  if (typeof MediaStreamTrackProcessor === "undefined") {
    throw new Error("this browser does not hand out a camera's pictures");
  }
  const stream = await devices.getUserMedia({
    video: {
      width: { ideal: input.width ?? 640 },
      height: { ideal: input.height ?? 480 },
      frameRate: { ideal: input.fps ?? 30 },
    },
  });
  const track = /** @type {MediaStreamVideoTrack} */ (stream.getVideoTracks()[0]);
  const { readable: frames } = new MediaStreamTrackProcessor({ track });
  return {
    stream,
    order: { kind: "pictures", input, frames },
    transfer: [frames],
    close: () => undefined,
  };
}
