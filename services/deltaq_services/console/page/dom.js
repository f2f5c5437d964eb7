// Small helpers for the page's elements.

/** The part of the page of that name, as index.html has it. */
export function part(name) {
  const found = document.querySelector(`[data-part="${name}"]`);
  if (!found) throw new Error(`the page has no part "${name}"`);
  return found;
}

/** A new element: el("button", {class: "plain", onclick: f}, "text", child, ...). */
export function el(tag, attributes = {}, ...children) {
  const svg = ["svg", "path", "circle", "line", "rect", "g", "text", "title"].includes(tag);
  const element = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "style") element.style.cssText = value; // the attribute is not let through by the page's policy
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

/** Set the text of an element, only if it differs. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** What the console serves at `url`; throws where it serves nothing. */
export async function fetched(url) {
  const answer = await fetch(url).catch(() => {
    throw new Error(`${url} could not be loaded: there is no connection to the console. Load the page again once the console runs.`);
  });
  if (!answer.ok) throw new Error(`${url} could not be loaded: the console answers ${answer.status}. Its log says why.`);
  return answer;
}

/** Offer a file to be saved. */
export function save(name, content, type) {
  const url = URL.createObjectURL(content instanceof Blob ? content : new Blob([content], { type }));
  el("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}

/** One of the page's own settings: it outlives the visit, or in "sessionStorage" the page, in this tab alone. */
export function remembered(name, fallback, storage = "localStorage") {
  try {
    return JSON.parse(globalThis[storage].getItem(`deltaq.${name}`)) ?? fallback;
  } catch {
    return fallback;
  }
}

export function remember(name, value, storage = "localStorage") {
  try {
    globalThis[storage].setItem(`deltaq.${name}`, JSON.stringify(value));
  } catch {
    // a private window: the setting lasts as long as the page
  }
}

export const degrees = (rad) => (rad * 180) / Math.PI;

/** Angles A B C about z, y, x of a pose (16 numbers, by columns), as a KUKA pendant tells them [°]. */
export const anglesOf = (T) => [Math.atan2(T[1], T[0]), Math.atan2(0 - T[2], Math.hypot(T[0], T[1])), Math.atan2(T[6], T[10])].map(degrees);

/** A pose T_world_tool as a KUKA pendant tells it: X Y Z [mm], and A B C [°]. */
export function poseText(T) {
  const named = (names, values, digits) => values.map((value, k) => `${names[k]} ${value.toFixed(digits)}`).join("  ");
  return `${named("XYZ", [T[12], T[13], T[14]].map((m) => 1000 * m), 0)} mm\n${named("ABC", anglesOf(T), 1)} °`;
}

/** Day and time of day of the reader's clock, whatever the browser's language: 2026-11-28 22:50:12. */
export function dateText(time_s) {
  const time = new Date(time_s * 1000);
  return new Date(time - 60000 * time.getTimezoneOffset()).toISOString().slice(0, 19).replace("T", " ");
}

/** A joint's position as people read it. */
export function jointText(value, unit) {
  return unit === "rad" ? `${degrees(value).toFixed(1)}°` : `${(value * 1000).toFixed(0)} mm`;
}
