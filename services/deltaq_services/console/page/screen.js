// What is seen of pictures that the processor draws. A browser without graphics hardware fetches a canvas of WebGL while it is
// being drawn; the page waits for it and hears nothing meanwhile, not even a press of STOP. So that canvas is not on the
// page: what was drawn is copied to this one when it is finished.

export class Screen {
  /** @param drawn canvas of WebGL, which is not on the page and preserves what was drawn. */
  constructor(drawn) {
    this._drawn = drawn;
    this.canvas = document.createElement("canvas");
    this._pen = this.canvas.getContext("2d", { alpha: false });
    this._kept = null;
  }

  /** Whether the next picture to be shown is as fine as the one that is, so that parts of this may be kept. */
  get maySkip() {
    return this.canvas.width === this._drawn.width && this.canvas.height === this._drawn.height;
  }

  /** Let a part of the page as it is when the next picture is shown: [x, y, width, height] in its pixels, from below. */
  keep(part) {
    this._kept = part;
  }

  /** Show what was drawn; to be called when it is finished. */
  show() {
    const { canvas, _drawn: { width, height }, _pen: pen } = this;
    const kept = this.maySkip ? this._kept : null;
    if (!this.maySkip) Object.assign(canvas, { width, height });
    pen.save();
    if (kept) {
      const [x, y, wide, high] = kept;
      pen.beginPath();
      pen.rect(0, 0, width, height);
      pen.rect(x, height - y - high, wide, high);
      pen.clip("evenodd");
    }
    pen.drawImage(this._drawn, 0, 0);
    pen.restore();
    this._kept = null;
  }
}
