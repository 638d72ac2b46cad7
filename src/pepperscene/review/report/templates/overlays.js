"use strict";

// Labels of images: they are drawn as images of classes and instances, and over photographs.

const controls = document.getElementById("overlays");
const classSwitches = controls ? [...controls.querySelectorAll("input[name=class]")] : [];
const classNames = new Map(classSwitches.map(input => [Number(input.value), input.dataset.name]));
const classColours = new Map(classSwitches.map(input => [Number(input.value), Number(input.dataset.colour)]));
// Names are drawn in images from this width in CSS pixels; in smaller ones they would hide the boxes.
const NAMES_FROM = 600;
const MASK_OPACITY = 0.6, KEYPOINT_LINES = [[0, 1], [1, 2]];

// The JSON in a data attribute: a zlib stream in base64.
async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).json();
}

const isOn = id => controls !== null && document.getElementById(id).checked;
const cssColour = code => "#" + code.toString(16).padStart(6, "0");

function shownClasses() {
  return new Set(classSwitches.filter(input => input.checked).map(input => Number(input.value)));
}

function colourOfClass(organ) {
  return classColours.get(organ) ?? Number(controls.dataset.ignored);
}

// The colour of each region as a pixel of ImageData; regions of other classes are transparent.
function regionPixels(labels, kind, classes) {
  return labels.classes.map((organ, region) => {
    if (classes && !classes.has(organ)) return 0;
    if (classes && kind === "instance" && labels.instances[region] === 0) return 0;
    const code = kind === "class" ? colourOfClass(organ) : labels.colours[region];
    return (0xff000000 | (code & 0xff) << 16 | (code & 0xff00) | code >> 16) >>> 0;
  });
}

// A canvas with one pixel for each pixel of the labels.
function labelCanvas(labels, kind, classes = null) {
  const canvas = document.createElement("canvas");
  canvas.width = Math.ceil(labels.width / labels.step);
  canvas.height = Math.ceil(labels.height / labels.step);
  const context = canvas.getContext("2d"), image = context.createImageData(canvas.width, canvas.height);
  const pixels = new Uint32Array(image.data.buffer), colours = regionPixels(labels, kind, classes);
  let start = 0;
  labels.lengths.forEach((length, run) => {
    pixels.fill(colours[labels.regions[run]], start, start + length);
    start += length;
  });
  context.putImageData(image, 0, 0);
  return canvas;
}

// The number of the region at a pixel.
function regionAt(labels, column, row) {
  const width = Math.ceil(labels.width / labels.step);
  const pixel = Math.floor(row / labels.step) * width + Math.floor(column / labels.step);
  let end = 0;
  const run = labels.lengths.findIndex(length => (end += length) > pixel);
  return labels.regions[run];
}

function describeRegion(labels, region) {
  const name = classNames.get(labels.classes[region]) ?? "no class", instance = labels.instances[region];
  return instance ? `${name}, instance ${instance}` : name;
}

// Draws what is switched on into a canvas that covers the photograph.
function drawOverlay(canvas, labels) {
  const ratio = window.devicePixelRatio || 1, classes = shownClasses();
  canvas.width = Math.round(canvas.clientWidth * ratio);
  canvas.height = Math.round(canvas.clientHeight * ratio);
  const context = canvas.getContext("2d"), scale = canvas.width / labels.width;
  const kind = isOn("class-masks") ? "class" : isOn("instance-masks") ? "instance" : "";
  if (kind && canvas.width > 0) {
    context.globalAlpha = MASK_OPACITY;
    context.imageSmoothingEnabled = false;
    context.drawImage(labelCanvas(labels, kind, classes), 0, 0, canvas.width, canvas.height);
    context.globalAlpha = 1;
  }
  if (isOn("boxes")) drawBoxes(context, labels, classes, scale, ratio, canvas.clientWidth >= NAMES_FROM);
  // Keypoints are those of fruit.
  const fruit = [...classNames].find(([, name]) => name === "pepper")[0];
  if (isOn("keypoints") && classes.has(fruit)) drawKeypoints(context, labels, scale, ratio);
}

function drawBoxes(context, labels, classes, scale, ratio, hasNames) {
  context.font = `${11 * ratio}px system-ui, sans-serif`;
  context.textBaseline = "top";
  context.lineWidth = 1.25 * ratio;
  labels.boxes.forEach((box, region) => {
    const organ = labels.classes[region];
    if (!box || !classes.has(organ)) return;
    const [left, top, right, bottom] = box.map(value => value * scale);
    context.strokeStyle = cssColour(colourOfClass(organ));
    context.strokeRect(left, top, right - left, bottom - top);
    if (!hasNames) return;
    // The name, where it fits into the box.
    const name = classNames.get(organ), width = context.measureText(name).width + 6 * ratio;
    if (right - left < width || bottom - top < 15 * ratio) return;
    context.fillStyle = "rgb(10 12 14 / .75)";
    context.fillRect(left, top, width, 15 * ratio);
    context.fillStyle = "#fff";
    context.fillText(name, left + 3 * ratio, top + 2 * ratio);
  });
}

// The cut point is a square, the end at the stalk a triangle, the blossom end a disc; hidden ones are hollow.
function drawKeypoints(context, labels, scale, ratio) {
  const size = 4.5 * ratio;
  const shapes = [
    (x, y) => context.rect(x - size, y - size, 2 * size, 2 * size),
    (x, y) => {
      context.moveTo(x, y - 1.3 * size);
      context.lineTo(x + 1.2 * size, y + size);
      context.lineTo(x - 1.2 * size, y + size);
      context.closePath();
    },
    (x, y) => context.arc(x, y, size, 0, 2 * Math.PI),
  ];
  context.lineWidth = 1.5 * ratio;
  context.strokeStyle = "#000";
  for (const points of labels.keypoints) {
    const placed = points.map(([x, y, visibility]) => [x * scale, y * scale, visibility]);
    context.beginPath();
    for (const [from, to] of KEYPOINT_LINES) {
      if (!placed[from][2] || !placed[to][2]) continue;
      context.moveTo(placed[from][0], placed[from][1]);
      context.lineTo(placed[to][0], placed[to][1]);
    }
    context.strokeStyle = "#fff";
    context.stroke();
    placed.forEach(([x, y, visibility], number) => {
      if (!visibility) return;
      context.beginPath();
      shapes[number](x, y);
      context.fillStyle = visibility === 2 ? "#ff2fa0" : "rgb(255 255 255 / .25)";
      context.fill();
      context.strokeStyle = visibility === 2 ? "#fff" : "#ff2fa0";
      context.stroke();
    });
  }
}

// Cards with labels; `labels` is known once they are unpacked.
const cards = [...document.querySelectorAll("[data-labels]")].map(card => ({
  card, overlay: card.querySelector(".overlay"), labels: null, isVisible: false,
}));
const cardOf = image => cards.find(({ card }) => card.contains(image)) ?? null;

function drawVisible() {
  for (const { overlay, labels, isVisible } of cards)
    if (overlay && labels && isVisible) drawOverlay(overlay, labels);
  document.dispatchEvent(new Event("overlays"));
}

async function drawCards() {
  for (const entry of cards) {
    entry.labels = await unpack(entry.card.dataset.labels);
    for (const kind of ["class", "instance"]) {
      const image = entry.card.querySelector(`img[data-kind=${kind}]`);
      if (image) image.src = labelCanvas(entry.labels, kind).toDataURL();
    }
    if (entry.overlay && entry.isVisible) drawOverlay(entry.overlay, entry.labels);
  }
  document.body.dataset.labelled = "true";
}

function toggle(input) {
  input.checked = !input.checked;
  input.dispatchEvent(new Event("change", { bubbles: true }));
}

if (controls) {
  const kinds = ["class-masks", "instance-masks"].map(id => document.getElementById(id));
  controls.addEventListener("change", event => {
    // One kind of masks at a time.
    if (event.target.checked && kinds.includes(event.target))
      kinds.filter(input => input !== event.target).forEach(input => { input.checked = false; });
    drawVisible();
  });
  document.getElementById("all-classes").addEventListener("click", () => {
    const isAll = classSwitches.every(input => input.checked);
    classSwitches.forEach(input => { input.checked = !isAll; });
    drawVisible();
  });
  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const target = controls.querySelector(`[aria-keyshortcuts="${CSS.escape(event.key.toLowerCase())}"]`);
    if (!target) return;
    if (target.type === "checkbox") toggle(target); else target.click();
  });
  const observer = new IntersectionObserver(entries => {
    for (const { target, isIntersecting } of entries) {
      const entry = cards.find(({ card }) => card === target);
      entry.isVisible = isIntersecting;
      if (isIntersecting && entry.overlay && entry.labels) drawOverlay(entry.overlay, entry.labels);
    }
  });
  cards.forEach(({ card }) => observer.observe(card));
  window.addEventListener("resize", drawVisible);
  drawCards();
}
