// What Quasar's elements lack for a reader of the screen.
(() => {
  // Between a list and its options nothing may take the focus. Popups are placed beside the page, in the body.
  const mend = (root) => {
    for (const inner of root.querySelectorAll("[role=listbox] .q-virtual-scroll__content[tabindex]")) inner.removeAttribute("tabindex");
  };
  // A dialog that is closed gives the focus back: Quasar would, but the server removes it at once.
  let last = null;
  document.addEventListener("focusin", (e) => { if (!e.target.closest("[role=dialog]")) last = e.target; });
  const back = () => { if (document.activeElement === document.body && last && last.isConnected) last.focus(); };
  new MutationObserver((changes) => {
    for (const change of changes) {
      for (const added of change.addedNodes) if (added instanceof Element) mend(added);
      for (const gone of change.removedNodes) if ((gone.id || "").startsWith("q-portal--dialog")) setTimeout(back);
    }
  }).observe(document.body, { childList: true });

  // Arrows step a number, as in the browser's own field of numbers, which would drop a decimal comma.
  document.addEventListener("keydown", (e) => {
    const field = e.target.closest("input[role=spinbutton]");
    if (!field || (e.key !== "ArrowUp" && e.key !== "ArrowDown")) return;
    const step = +field.getAttribute("step") || 1, now = +field.value.replace(",", ".") || 0;
    const digits = Math.max(...[step, now].map((x) => (String(x).split(".")[1] || "").length));
    field.value = (now + (e.key === "ArrowUp" ? step : -step)).toFixed(digits);
    field.dispatchEvent(new Event("input", { bubbles: true }));
    e.preventDefault();
  });

  // The thumb of a slider takes the focus, but its name and value are those of the element around it.
  const copy = (slider, thumb) => {
    for (const name of ["role", "aria-label", "aria-valuemin", "aria-valuemax", "aria-valuenow"]) thumb.setAttribute(name, slider.getAttribute(name) || "");
  };
  document.addEventListener("focusin", (e) => {
    const slider = e.target.closest(".q-slider");
    if (!slider || slider === e.target) return;
    copy(slider, e.target);
    const watch = new MutationObserver(() => copy(slider, e.target));
    watch.observe(slider, { attributeFilter: ["aria-valuenow", "aria-valuemin", "aria-valuemax"] });
    e.target.addEventListener("focusout", () => watch.disconnect(), { once: true });
  });
})();
