// three.js 0.180.0, as its package has it; of OrbitControls.js the import names the file beside it. Roboto is 5.3.0 of Fontsource.

export * as THREE from "./three.module.min.js";
export { OrbitControls } from "./OrbitControls.js";
