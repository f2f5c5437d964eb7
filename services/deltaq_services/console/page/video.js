// The live picture of a camera's eye: JPEGs over a WebSocket. Each is asked for, so that none waits on a slow line.

import { el } from "./dom.js";

export const OLD_MS = 400; // as a state that is older is not driven by
const RECORDED_MS = 200; // between two pictures of a recording
const FROZEN_S = 1; // equal for so long: a camera that stands still sees noise
const AHEAD = 2; // pictures that are asked for at a time
const SILENT_MS = 5000;
const RETRY_MS = [250, 500, 1000, 2000];
const VERSION = 1;
const HEAD_BYTES = 20; // as deltaq_services/video_stream.py packs them

export class Video {
  /** @param connection Connection, whose address and clock are used; name of the stream; resized called with each new size. */
  constructor(connection, name, resized) {
    Object.assign(this, { connection, name, resized, canvas: el("canvas"), captured_ms: NaN, glass_ms: NaN, unchanged_s: 0, words: "", _attempt: 0 });
    this._context = this.canvas.getContext("2d");
  }

  /** Show pictures from now on, or none any more. */
  set isOn(isOn) {
    if (isOn === !!this._watch) return;
    clearInterval(this._watch);
    this._watch = isOn ? setInterval(() => this._look(), RETRY_MS[0]) : null;
    if (isOn) Object.assign(this, { _recorded: null, _shownUrl: null, captured_ms: NaN });
    if (isOn) this._connect();
    else this._drop("");
  }

  /** Show a picture of a recording, as `Replay` tells it; null for none. The newest that was asked for is shown last. */
  async showRecorded(picture) {
    this._recorded = picture ?? { url: "", age_ms: NaN };
    if (this._recorded.url === this._shownUrl || this._isFetching) return;
    this._isFetching = true;
    const { url } = this._recorded;
    const token = new URLSearchParams(location.search).get("token");
    const answer = url ? await fetch(url, token ? { headers: { Authorization: `Bearer ${token}` } } : {}).catch(() => null) : null;
    if (answer?.ok) await this._draw(await answer.blob());
    else this._context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.words = url && !answer?.ok ? "its picture is not kept" : "";
    Object.assign(this, { _shownUrl: url, _isFetching: false });
  }

  /** Age of the picture that is shown [ms]: from capture, on the console's clock, or in the recording. */
  get age_ms() {
    if (this._recorded) return this.words ? NaN : this._recorded.age_ms - RECORDED_MS;
    return this.connection.now() + this.connection.ahead_ms - this.captured_ms;
  }

  /** What is wrong with what is shown, in words; empty if it is live. */
  get fault() {
    if (this.age_ms < OLD_MS) return this._recorded || this.unchanged_s < FROZEN_S ? "" : `frozen: no pixel has changed for ${this.unchanged_s.toFixed(0)} s`;
    const age = Number.isFinite(this.age_ms) ? `old: ${(this.age_ms / 1000).toFixed(1)} s` : "none yet";
    return this.words ? `${age} (${this.words})` : age;
  }

  _connect() {
    const url = new URL(this.connection.url);
    url.pathname = `/video/${this.name}`;
    const socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    this._socket = socket;
    this._heardAt = performance.now();
    socket.onopen = () => Array.from({ length: AHEAD }, () => this._ask(socket));
    socket.onmessage = ({ data }) => this._take(socket, data);
    socket.onclose = ({ reason }) => socket === this._socket && this._drop(reason || "no connection to the console");
  }

  _ask(socket) {
    if (socket.readyState === WebSocket.OPEN) socket.send("next");
  }

  /** Connect again in a while. */
  _drop(words) {
    const socket = this._socket;
    this._socket = null;
    this.words = words;
    this._retryAt = performance.now() + RETRY_MS[Math.min(this._attempt++, RETRY_MS.length - 1)];
    if (socket) socket.onclose = null;
    socket?.close();
  }

  _look() {
    if (!this._socket && performance.now() > this._retryAt) this._connect();
    else if (this._socket && performance.now() - this._heardAt > SILENT_MS) this._drop("the service of its picture is silent");
  }

  async _take(socket, data) {
    this._heardAt = performance.now();
    const head = new DataView(data, 0, HEAD_BYTES);
    if (head.getUint8(0) !== VERSION) this.words = `pictures of version ${head.getUint8(0)}; this page reads ${VERSION}: reload it`;
    else if (head.getUint8(1)) this.words = new TextDecoder().decode(new Uint8Array(data, HEAD_BYTES));
    else await this._show(socket, head, new Blob([new Uint8Array(data, HEAD_BYTES)], { type: "image/jpeg" }));
    this._ask(socket);
  }

  /** Draw a JPEG, if it still is to be shown once it is decoded; returns whether it was drawn. */
  async _draw(jpeg, isWanted = () => true) {
    const bitmap = await createImageBitmap(jpeg).catch(() => null);
    if (!bitmap || !isWanted()) return false;
    if (this.canvas.width !== bitmap.width || this.canvas.height !== bitmap.height) {
      Object.assign(this.canvas, { width: bitmap.width, height: bitmap.height });
      this.resized();
    }
    this._context.drawImage(bitmap, 0, 0);
    bitmap.close();
    return true;
  }

  async _show(socket, head, jpeg) {
    const captured_ms = 1000 * head.getFloat64(8, true);
    if (!(await this._draw(jpeg, () => socket === this._socket && !(captured_ms < this.captured_ms)))) return;
    Object.assign(this, { captured_ms, unchanged_s: head.getFloat32(16, true), words: "", _attempt: 0 });
    // the frame after next of the screen has it
    requestAnimationFrame(() => requestAnimationFrame(() => (this.glass_ms = this.connection.now() + this.connection.ahead_ms - captured_ms)));
  }
}
