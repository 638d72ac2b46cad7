// Images that open large, with the overlays of photographs.

const dialog = document.getElementById("large"), stage = dialog.querySelector(".stage");
const large = dialog.querySelector("img"), caption = dialog.querySelector("p");
const largeOverlay = dialog.querySelector("canvas");
const images = [...document.querySelectorAll(".picture img")];
let current = 0;

function show(index) {
  current = (index + images.length) % images.length;
  const { src, alt, className } = images[current];
  const [columns, rows] = ["width", "height"].map(name => Number(images[current].getAttribute(name)));
  Object.assign(large, { src, alt, className });
  stage.style.setProperty("--aspect", columns / rows);
  caption.textContent = alt;
  if (!dialog.open) {
    dialog.showModal();
    // A modal dialog makes the rest of the page inert: the switches move into it.
    if (controls) dialog.append(controls);
    dialog.classList.toggle("switched", controls !== null);
  }
  drawLargeOverlay();
}

function drawLargeOverlay() {
  if (!dialog.open) return;
  const labels = cardOf(images[current])?.labels;
  largeOverlay.hidden = !labels || images[current].dataset.kind !== "colour";
  if (!largeOverlay.hidden) drawOverlay(largeOverlay, labels);
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
images.forEach((image, index) => image.closest("button").addEventListener("click", () => show(index)));
dialog.querySelector(".before").addEventListener("click", () => show(current - 1));
dialog.querySelector(".after").addEventListener("click", () => show(current + 1));
dialog.addEventListener("click", event => {
  if (!event.target.closest(".before, .after, #overlays")) dialog.close();
});
dialog.addEventListener("keydown", event => {
  if (keys[event.key]) { event.preventDefault(); show(keys[event.key]()); }
});
// The caption names the class and the instance below the pointer.
stage.addEventListener("pointermove", event => {
  const labels = cardOf(images[current])?.labels, box = stage.getBoundingClientRect();
  if (!labels) return;
  const column = Math.floor((event.clientX - box.left) / box.width * labels.width);
  const row = Math.floor((event.clientY - box.top) / box.height * labels.height);
  if (column < 0 || row < 0 || column >= labels.width || row >= labels.height) return;
  caption.textContent = `${images[current].alt}: ${describeRegion(labels, regionAt(labels, column, row))}`;
});
stage.addEventListener("pointerleave", () => { caption.textContent = images[current].alt; });
document.addEventListener("overlays", drawLargeOverlay);
window.addEventListener("resize", drawLargeOverlay);
// On closing, the focus moves to the last image shown.
dialog.addEventListener("close", () => {
  if (controls) document.getElementById("overlay-home").append(controls);
  images[current].closest("button").focus();
});
document.getElementById("bright").addEventListener("change", event =>
  document.body.classList.toggle("bright", event.target.checked));
