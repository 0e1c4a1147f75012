// What hands do anywhere on the page: drop or choose a file, close a message, copy a field, press a key.
import { element, say } from "./dom.js";

/** Listens for it; `open(file)` shows a file, `play()` starts or halts the films, where there are some. */
export function listen({ open, play }) {
  document.addEventListener("dragover", (event) => {
    event.preventDefault();
    document.body.classList.add("dropping");
  });
  for (const kind of ["dragleave", "drop"]) document.addEventListener(kind, () => document.body.classList.remove("dropping"));
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    open(event.dataTransfer.files[0]);
  });
  element("file").addEventListener("change", ({ target }) => {
    open(target.files[0]);
    // The same file can be chosen again.
    target.value = "";
  });

  element("heard").addEventListener("click", () => {
    say("error", "");
    // This button is gone.
    element("moment-title").focus({ preventScroll: true });
  });

  document.addEventListener("click", async ({ target }) => {
    const field = element(target.dataset?.copy ?? "");
    if (!field) return;
    field.select();
    const copied = navigator.clipboard?.writeText(field.value);
    element("copied").textContent = await (copied ?? Promise.reject()).then(
      () => "Copied.",
      () => "Selected: copy it with the keyboard or the menu.",
    );
  });

  document.addEventListener("keydown", (event) => {
    if (!element("shortcuts").checked || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest("input:not([type=radio]), select, textarea")) return;
    if (event.key === ".") element("next").click();
    if (event.key === ",") element("previous").click();
    if (event.key !== " " || event.target.closest("button, input, summary, a, [tabindex='0']")) return;
    if (play()) event.preventDefault();
  });
}
