// What is seen of pictures that the processor draws. A browser without graphics hardware fetches a canvas of WebGL while it is
// being drawn; the page waits for it and hears nothing meanwhile, not even a press of STOP. So that canvas is not on the
// page: what was drawn is copied to this one when it is finished.

export class Screen {
  /** @param drawn canvas of WebGL, which is not on the page and preserves what was drawn. */
  constructor(drawn) {
    this._drawn = drawn;
    this.canvas = document.createElement("canvas");
    this._pen = this.canvas.getContext("2d", { alpha: false });
  }

  /** Show what was drawn; to be called when it is finished. */
  show() {
    const { canvas, _drawn: { width, height } } = this;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this._pen.drawImage(this._drawn, 0, 0);
  }
}
