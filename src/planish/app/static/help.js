/** The dialog of keys and mouse: opened by its button or by the key ?, closed by Esc. */

export function bindHelp(dialog, opener) {
  opener.addEventListener("click", () => dialog.showModal());
  document.addEventListener("keydown", (event) => {
    const writes = event.target instanceof HTMLElement && event.target.matches("textarea, input:not([type=checkbox], [type=range])");
    if (event.key === "?" && !writes && !dialog.open) dialog.showModal();
  });
}
