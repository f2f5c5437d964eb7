// The custom element: an empty place for the 3D view, from which the page is brought to life.

import { start } from "deltaq-console";

export default {
  template: `<div class="cell-view"></div>`,
  async mounted() {
    await this.$nextTick();
    this.stop = await start(this.$el);
  },
  unmounted() {
    this.stop?.();
  },
};
