// What Quasar's popups lack for a reader of the screen: between a list and its options nothing may take the focus.
(() => {
  const mend = (root) => {
    for (const inner of root.querySelectorAll("[role=listbox] .q-virtual-scroll__content[tabindex]")) inner.removeAttribute("tabindex");
  };
  // Popups are placed beside the page, as children of the body.
  new MutationObserver((changes) => {
    for (const change of changes) for (const added of change.addedNodes) if (added instanceof Element) mend(added);
  }).observe(document.body, { childList: true });
})();
