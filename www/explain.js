// What an explanation speaks of lights up in its panel; chosen, it comes into view.

/** Listens from now on. */
export function lightUp() {
  for (const kind of ["pointerover", "focusin", "click"]) document.addEventListener(kind, light);
  document.addEventListener("keydown", ({ key, target }) => key === "Enter" && light({ target, type: "click" }));
}

function light({ target, type }) {
  for (const lit of document.querySelectorAll(".lit")) lit.classList.remove("lit");
  const way = target.closest?.("[data-light]");
  if (!way) return;
  const parts = document.querySelectorAll(way.dataset.light);
  for (const part of parts) part.classList.add("lit");
  if (type === "click") parts[0].scrollIntoView({ block: "center" });
}
