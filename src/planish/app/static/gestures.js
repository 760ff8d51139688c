/** Mouse, touch and wheel, the same in every view: a drag moves it, Shift or a tool selects, the wheel zooms with the focus. */

/**
 * @typedef {number[]} Place screen pixels to the right and down from the upper left corner of the view
 * @typedef {{move: (at: Place) => void, end: (at: Place) => void, cancel?: () => void}} Held what a drag moves
 */

/** A press that moves less is a click, in screen pixels. */
const CLICK_PX = 4;

/**
 * Tell a view what mouse, touch and wheel do in it.
 * @param {HTMLElement} element the view
 * @param {object} on what it does then
 * @param {(right: number, down: number) => void} on.pan moves the view by screen pixels
 * @param {(factor: number, at: Place) => void} on.zoom comes closer where the factor is above 1
 * @param {(at: Place) => void} [on.click] a press that does not move
 * @param {(at: Place|null) => void} [on.hover] the pointer moves, or leaves the view
 * @param {(at: Place, shift: boolean) => Held|null} [on.take] gives what a drag moves; where it gives null, the drag
 *   moves the view
 */
export function bindGestures(element, on) {
  const fingers = new Map();
  let press = null;
  const placeOf = (event) => {
    const box = element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const apart = () => {
    const [a, b] = [...fingers.values()];
    return { far: Math.max(Math.hypot(a[0] - b[0], a[1] - b[1]), 1), middle: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2] };
  };
  const cancel = () => {
    press?.held?.cancel?.();
    press = null;
  };
  element.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || /** @type {Element} */ (event.target).closest("button")) return;
    const at = placeOf(event);
    fingers.set(event.pointerId, at);
    if (fingers.size > 1) return cancel();
    element.setPointerCapture(event.pointerId);
    press = { start: at, last: at, moved: false, held: on.take?.(at, event.shiftKey) ?? null };
  });
  element.addEventListener("pointermove", (event) => {
    const at = placeOf(event);
    if (fingers.size === 2 && fingers.has(event.pointerId)) {
      const before = apart();
      fingers.set(event.pointerId, at);
      const { far, middle } = apart();
      on.pan(middle[0] - before.middle[0], middle[1] - before.middle[1]);
      return on.zoom(far / before.far, middle);
    }
    if (!press) return on.hover?.(at);
    press.moved ||= Math.hypot(at[0] - press.start[0], at[1] - press.start[1]) > CLICK_PX;
    if (!press.moved) return;
    if (press.held) press.held.move(at);
    else on.pan(at[0] - press.last[0], at[1] - press.last[1]);
    press.last = at;
  });
  element.addEventListener("pointerup", (event) => {
    fingers.delete(event.pointerId);
    const { held, moved } = press ?? { held: null, moved: true };
    press = null;
    if (held && moved) held.end(placeOf(event));
    else if (!moved) on.click?.(placeOf(event));
  });
  element.addEventListener("pointercancel", (event) => {
    fingers.delete(event.pointerId);
    cancel();
  });
  element.addEventListener("pointerleave", () => !press && on.hover?.(null));
  element.addEventListener(
    "wheel",
    (event) => {
      if (!event.ctrlKey && !event.metaKey && !element.contains(document.activeElement)) return; // the page scrolls
      event.preventDefault();
      const far = event.deltaY * (event.deltaMode ? 16 : 1);
      on.zoom(Math.exp(-Math.max(-200, Math.min(200, far)) / 300), placeOf(event));
    },
    { passive: false },
  );
}
