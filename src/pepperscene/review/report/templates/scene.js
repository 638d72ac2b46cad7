// The 3D view of a scene. three.js' own controls let the horizon tilt and have no keys; these keep z up.

const view = document.getElementById("scene");

function buildScene(data) {
  const scene = new THREE.Scene(), organs = new Map();
  for (const [organ, { positions, faces }] of Object.entries(data.organs)) {
    const geometry = new THREE.BufferGeometry();
    const metres = Float32Array.from(positions, value => value / 1000);
    geometry.setAttribute("position", new THREE.BufferAttribute(metres, 3));
    geometry.setIndex(faces);
    geometry.computeVertexNormals();
    const colour = Number(view.querySelector(`input[name=organ][value="${organ}"]`).dataset.colour);
    const material = new THREE.MeshLambertMaterial({ color: colour, side: THREE.DoubleSide });
    organs.set(organ, new THREE.Mesh(geometry, material));
    scene.add(organs.get(organ));
  }
  scene.add(new THREE.HemisphereLight(0xffffff, 0x606060, 0.65));
  const lamp = new THREE.DirectionalLight(0xffffff, 0.75);
  scene.add(lamp, lamp.target);
  return { scene, organs, lamp };
}

// Lines from the projection centre to the corners, and around the image.
function frustumLines(cameras, colour) {
  const ends = [0, 1, 0, 2, 0, 3, 0, 4, 1, 2, 2, 3, 3, 4, 4, 1];
  const values = cameras.flatMap(({ points }) => ends.flatMap(end => points[end])).map(value => value / 1000);
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(values, 3));
  return new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: colour }));
}

// Hundreds of frustums would cover the plants: other frames are points.
function cameraPoints(cameras, colour) {
  const geometry = new THREE.BufferGeometry();
  const values = cameras.flatMap(({ points }) => points[0]).map(value => value / 1000);
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(values, 3));
  return new THREE.Points(geometry, new THREE.PointsMaterial({ color: colour, size: 5, sizeAttenuation: false }));
}

// A camera that looks at a target from a distance and two angles, with the horizon level.
class Orbit {
  constructor(box) {
    this.camera = new THREE.PerspectiveCamera(40, 1, 0.01, 200);
    this.camera.up.set(0, 0, 1);
    this.box = box;
    this.reset();
  }

  // From the side of the aisle, which is at -y, and slightly from above.
  reset() {
    this.target = this.box.getCenter(new THREE.Vector3());
    this.distance = 1.1 * this.box.getBoundingSphere(new THREE.Sphere()).radius / Math.sin(Math.PI / 9);
    this.azimuth = -0.6;
    this.elevation = 0.25;
  }

  rotate(right, up) {
    this.azimuth -= right;
    this.elevation = Math.min(1.55, Math.max(-1.55, this.elevation + up));
  }

  move(right, up) {
    const scale = this.distance;
    const side = new THREE.Vector3(1, 0, 0).applyQuaternion(this.camera.quaternion);
    const above = new THREE.Vector3(0, 1, 0).applyQuaternion(this.camera.quaternion);
    this.target.addScaledVector(side, right * scale).addScaledVector(above, up * scale);
  }

  zoom(factor) {
    this.distance = Math.min(100, Math.max(0.1, this.distance * factor));
  }

  update(aspect) {
    // The scene also fits into a view that is higher than wide.
    const distance = this.distance / Math.min(1, aspect), flat = Math.cos(this.elevation) * distance;
    this.camera.position.set(
      flat * Math.cos(this.azimuth), flat * Math.sin(this.azimuth), Math.sin(this.elevation) * distance,
    ).add(this.target);
    this.camera.lookAt(this.target);
    this.camera.aspect = aspect;
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
  }
}

async function showScene() {
  const canvas = view.querySelector("canvas"), status = view.querySelector(".status");
  const data = await unpack(view.dataset.scene), { cameras } = data;
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
  } catch {
    status.textContent = "This browser cannot draw in 3D: it has no WebGL.";
    return;
  }
  const { scene, organs, lamp } = buildScene(data);
  scene.background = new THREE.Color(0x0d0f14);
  scene.add(cameraPoints(cameras, 0x9aa4b0), frustumLines(cameras.filter(({ card }) => card), 0xf2f5f7));
  const box = new THREE.Box3().setFromObject(scene), orbit = new Orbit(box);
  // The ground, in squares of half a metre.
  const metres = Math.ceil(2 * box.getBoundingSphere(new THREE.Sphere()).radius) + 1;
  const grid = new THREE.GridHelper(metres, 2 * metres, 0x39424a, 0x262d33);
  scene.add(grid.rotateX(Math.PI / 2));
  let selected = -1, highlight = null, isPending = false;

  function draw() {
    isPending = false;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    renderer.setPixelRatio(window.devicePixelRatio || 1);
    renderer.setSize(width, height, false);
    orbit.update(Math.max(width, 1) / Math.max(height, 1));
    // The light is above the viewer.
    lamp.position.copy(orbit.camera.position).add(new THREE.Vector3(0, 0, orbit.distance));
    lamp.target.position.copy(orbit.target);
    renderer.render(scene, orbit.camera);
  }

  function redraw() {
    if (!isPending) requestAnimationFrame(draw);
    isPending = true;
  }

  function select(number) {
    if (number === selected) return;
    selected = number;
    if (highlight) scene.remove(highlight);
    highlight = null;
    canvas.dataset.frame = number < 0 ? "" : cameras[number].index;
    if (number >= 0) {
      const { index, card, points } = cameras[number], name = `Frame ${String(index).padStart(6, "0")}`;
      highlight = frustumLines([cameras[number]], 0xff9150);
      // It is drawn last, over what hides it.
      highlight.material.depthTest = false;
      highlight.renderOrder = 1;
      scene.add(highlight);
      const link = document.createElement(card ? "a" : "span");
      if (card) link.href = `#${card}`;
      link.textContent = name;
      const place = points[0].map(value => (value / 1000).toFixed(2)).join(", ");
      status.replaceChildren(link, `, camera at (${place}) m`);
    } else {
      status.textContent = "";
    }
    redraw();
  }

  // The number of the camera whose centre is drawn nearest to a point, or -1.
  function cameraAt(event) {
    const area = canvas.getBoundingClientRect(), point = new THREE.Vector3();
    let nearest = -1, least = 14;
    cameras.forEach(({ points }, number) => {
      point.fromArray(points[0]).divideScalar(1000).project(orbit.camera);
      if (point.z > 1) return;
      const x = area.left + (point.x + 1) / 2 * area.width, y = area.top + (1 - point.y) / 2 * area.height;
      const distance = Math.hypot(event.clientX - x, event.clientY - y);
      if (distance < least) [nearest, least] = [number, distance];
    });
    return nearest;
  }

  canvas.addEventListener("pointerdown", event => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("contextmenu", event => event.preventDefault());
  canvas.addEventListener("pointermove", event => {
    if (event.buttons === 0) {
      const number = cameraAt(event);
      if (number >= 0) select(number);
      return;
    }
    const scale = 1 / canvas.clientHeight, right = event.movementX * scale, up = event.movementY * scale;
    if (event.shiftKey || event.buttons & 6) orbit.move(-right, up); else orbit.rotate(4 * right, 4 * up);
    redraw();
  });
  canvas.addEventListener("click", event => { const number = cameraAt(event); if (number >= 0) select(number); });
  canvas.addEventListener("wheel", event => {
    // The page scrolls as long as the view does not have the focus.
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    orbit.zoom(Math.exp(Math.sign(event.deltaY) * 0.12));
    redraw();
  }, { passive: false });

  const step = 0.1, near = 0.05;
  const actions = { nearer: () => orbit.zoom(0.8), farther: () => orbit.zoom(1.25), reset: () => orbit.reset() };
  const keyActions = {
    ArrowLeft: event => event.shiftKey ? orbit.move(-near, 0) : orbit.rotate(-step, 0),
    ArrowRight: event => event.shiftKey ? orbit.move(near, 0) : orbit.rotate(step, 0),
    ArrowUp: event => event.shiftKey ? orbit.move(0, near) : orbit.rotate(0, step),
    ArrowDown: event => event.shiftKey ? orbit.move(0, -near) : orbit.rotate(0, -step),
    "+": actions.nearer, "=": actions.nearer, "-": actions.farther, Home: actions.reset,
    n: () => select((selected + 1) % cameras.length),
    p: () => select((selected + cameras.length - (selected < 0 ? 0 : 1)) % cameras.length),
  };
  canvas.addEventListener("keydown", event => {
    if (event.ctrlKey || event.altKey || event.metaKey || !keyActions[event.key]) return;
    event.preventDefault();
    keyActions[event.key](event);
    redraw();
  });
  view.querySelectorAll("[data-action]").forEach(button => button.addEventListener("click", () => {
    actions[button.dataset.action]();
    redraw();
  }));
  view.querySelectorAll("input[name=organ]").forEach(input => input.addEventListener("change", () => {
    const mesh = organs.get(input.value);
    if (mesh) mesh.visible = input.checked;
    redraw();
  }));
  new ResizeObserver(redraw).observe(canvas);
  draw();
  view.dataset.drawn = "true";
}

showScene();
