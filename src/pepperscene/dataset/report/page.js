"use strict";
const dialog = document.getElementById("large");
const large = dialog.querySelector("img"), caption = dialog.querySelector("p");
const images = [...document.querySelectorAll(".picture img")];
let current = 0;

function show(index) {
  current = (index + images.length) % images.length;
  const { src, alt, className } = images[current];
  Object.assign(large, { src, alt, className });
  caption.textContent = alt;
  if (!dialog.open) dialog.showModal();
}

// Index of the next image of the same kind: that of another frame.
function sameKind(step) {
  for (let index = current + step; images[index]; index += step)
    if (images[index].dataset.kind === images[current].dataset.kind) return index;
  return current;
}

const keys = {
  ArrowRight: () => current + 1, ArrowLeft: () => current - 1,
  ArrowDown: () => sameKind(1), ArrowUp: () => sameKind(-1), Home: () => 0, End: () => images.length - 1,
};
images.forEach((image, index) => image.parentElement.addEventListener("click", () => show(index)));
dialog.querySelector(".before").addEventListener("click", () => show(current - 1));
dialog.querySelector(".after").addEventListener("click", () => show(current + 1));
dialog.addEventListener("click", event => { if (!event.target.matches(".before, .after")) dialog.close(); });
dialog.addEventListener("keydown", event => {
  if (keys[event.key]) { event.preventDefault(); show(keys[event.key]()); }
});
// On closing, the focus moves to the last image shown.
dialog.addEventListener("close", () => images[current].parentElement.focus());
document.getElementById("bright").addEventListener("change", event =>
  document.body.classList.toggle("bright", event.target.checked));
