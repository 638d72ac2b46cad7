"use strict";
const large = document.getElementById("large");
const shown = large.querySelector("img"), caption = large.querySelector("p");
const pictures = [...document.querySelectorAll(".picture img")];
let at = 0;

function show(place) {
  at = (place + pictures.length) % pictures.length;
  const picture = pictures[at];
  shown.src = picture.src;
  shown.alt = picture.alt;
  shown.className = picture.className;
  caption.textContent = picture.alt;
  if (!large.open) large.showModal();
}

// The next picture of the same kind: of the frame before or after.
function alike(step) {
  for (let place = at + step; pictures[place]; place += step)
    if (pictures[place].dataset.kind === pictures[at].dataset.kind) return place;
  return at;
}

const moves = {
  ArrowRight: () => at + 1, ArrowLeft: () => at - 1, ArrowDown: () => alike(1), ArrowUp: () => alike(-1),
  Home: () => 0, End: () => pictures.length - 1,
};
pictures.forEach((picture, place) => picture.parentElement.addEventListener("click", () => show(place)));
large.querySelector(".before").addEventListener("click", () => show(at - 1));
large.querySelector(".after").addEventListener("click", () => show(at + 1));
large.addEventListener("click", event => { if (!event.target.matches(".before, .after")) large.close(); });
large.addEventListener("keydown", event => {
  if (moves[event.key]) { event.preventDefault(); show(moves[event.key]()); }
});
// Where one has gone to in the large view is where one goes on in the page.
large.addEventListener("close", () => pictures[at].parentElement.focus());
document.getElementById("bright").addEventListener("change", event =>
  document.body.classList.toggle("bright", event.target.checked));
