// What an explanation speaks of lights up in its panel; chosen, it comes into view.

/** Listens from now on. */
export function lightUp() {
  // A formula is no text by itself, and a button needs a name.
  for (const way of document.querySelectorAll("[data-light]:has(math)")) way.ariaLabel = way.textContent;
  for (const kind of ["pointerover", "focusin", "click"]) document.addEventListener(kind, light);
}

function light({ target, type }) {
  for (const lit of document.querySelectorAll(".lit")) lit.classList.remove("lit");
  const way = target.closest?.("[data-light]");
  if (!way) return;
  const parts = document.querySelectorAll(way.dataset.light);
  for (const part of parts) part.classList.add("lit");
  // Before the first check there are no ratings.
  if (type === "click") parts[0]?.scrollIntoView({ block: "center" });
}
