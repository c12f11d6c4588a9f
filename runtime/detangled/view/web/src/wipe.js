// The divider between before and after: dragged, or moved by keys.

const STEP = 0.05;

export function wipe(handle, stage, moved) {
  const container = stage.canvas.parentElement;
  const set = (share) => {
    stage.split = Math.max(0, Math.min(1, share));
    handle.style.left = `${100 * stage.split}%`;
    const percent = Math.round(100 * stage.split);
    handle.setAttribute("aria-valuenow", percent);
    handle.setAttribute("aria-valuetext", `${percent} % before`);
    stage.moved();
    moved(stage.split);
  };
  handle.addEventListener("pointerdown", (event) => {
    handle.setPointerCapture(event.pointerId);
    handle.focus({ preventScroll: true });
    event.preventDefault();
  });
  handle.addEventListener("pointermove", (event) => {
    if (!handle.hasPointerCapture(event.pointerId)) return;
    const box = container.getBoundingClientRect();
    set((event.clientX - box.left) / box.width);
  });
  handle.addEventListener("keydown", (event) => {
    const to = {
      ArrowLeft: stage.split - STEP,
      ArrowDown: stage.split - STEP,
      ArrowRight: stage.split + STEP,
      ArrowUp: stage.split + STEP,
      PageDown: stage.split - 4 * STEP,
      PageUp: stage.split + 4 * STEP,
      Home: 0,
      End: 1,
    }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    set(to);
  });
  handle.hidden = false;
  set(0.5);
  return { left: () => set(stage.split - STEP), right: () => set(stage.split + STEP) };
}
