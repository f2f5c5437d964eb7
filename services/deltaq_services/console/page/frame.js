// The binary frame of the live WebSocket, as deltaq_services/console/frame.py packs it.

export const PHASES = ["offline", "ready", "engaged", "braking", "held"];
export const OUTCOMES = ["admitted", "scaled", "held", "refused", "unknown", "carried"];
const VERSION = 2;
const NO_BODY = 65535;
const NO_OUTCOME = 255;

/** Read one frame; throws where it is none. */
export function readFrame(buffer) {
  const view = new DataView(buffer);
  let at = 0;
  const u8 = () => view.getUint8(at++);
  const u16 = () => view.getUint16((at += 2) - 2, true);
  const f32 = () => view.getFloat32((at += 4) - 4, true);
  const f64 = () => view.getFloat64((at += 8) - 8, true);
  const vector = () => [f32(), f32(), f32()];
  const point = () => ((found) => (found.every(Number.isFinite) ? found : null))(vector());
  const joints = (count) => Float64Array.from({ length: count }, f32);
  const body = () => ((index) => (index === NO_BODY ? null : index))(u16());

  const version = u8();
  if (version !== VERSION) throw new Error(`frame of version ${version}; this page reads ${VERSION}: reload it`);
  const count = u8();
  u16();
  const frame = { server_s: f64(), nearest: null, robots: [] };
  const [a, b, distance] = [body(), body(), f32()];
  const points = [vector(), vector()];
  if (a !== null && b !== null && Number.isFinite(distance)) frame.nearest = { a, b, distance, points };
  for (let k = 0; k < count; k++) {
    const n = u8();
    const phase = PHASES[u8()] ?? "offline";
    const outcome = u8();
    const flags = u8();
    frame.robots.push({
      phase,
      outcome: outcome === NO_OUTCOME ? null : (OUTCOMES[outcome] ?? "unknown"),
      isStale: (flags & 1) !== 0,
      isBraking: (flags & 2) !== 0,
      age_s: f32(),
      clearance_m: f32(),
      pair: [body(), body()],
      admission: f32(),
      longest_s: f32(),
      focus: point(),
      q: joints(n),
      rest: joints(n),
    });
  }
  return frame;
}
