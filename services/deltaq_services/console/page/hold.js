// Buttons that do something while they are held, or only once they have been held long enough.

/** Let a button be held: by pointer, or by Space and Enter. `begin` returns false where nothing is held. */
export function holds(button, begin, end) {
  const start = () => {
    if (begin() !== false) button.dataset.held = "true";
  };
  const stop = () => {
    delete button.dataset.held;
    end();
  };
  button.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    button.setPointerCapture(event.pointerId);
    start();
  });
  for (const kind of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) button.addEventListener(kind, stop);
  button.addEventListener("keydown", (event) => {
    if (![" ", "Enter"].includes(event.key)) return;
    event.preventDefault();
    if (!event.repeat) start();
  });
  button.addEventListener("keyup", stop);
  button.addEventListener("contextmenu", (event) => event.preventDefault());
}

/** Call `action` once the button has been held for so long; letting go earlier does nothing. */
export function holdsFor(button, ms, action) {
  let timer = null;
  button.style.setProperty("--hold", `${ms}ms`);
  holds(
    button,
    () => {
      clearTimeout(timer);
      timer = setTimeout(action, ms);
    },
    () => clearTimeout(timer),
  );
}
