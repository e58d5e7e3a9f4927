// Turns meshes on a 2D canvas, far faces first; arrow keys or dragging turn, Ctrl and the wheel or + and - zoom,
// 0 goes back. The bare wheel and a finger that moves up or down belong to the page, so that it scrolls on.
for (const view of document.querySelectorAll(".mesh-view")) {
  const canvas = view.querySelector("canvas"), pen = canvas.getContext("2d");
  const bytes = (name) => Uint8Array.from(atob(view.dataset[name]), (c) => c.charCodeAt(0)).buffer;
  const nodes = new Int16Array(bytes("nodes")), faces = new Uint16Array(bytes("faces"));
  const regions = new Uint8Array(bytes("regions")), count = regions.length;
  const colors = JSON.parse(view.dataset.colors).map((hex) =>
    [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)));
  const START = { turn: -0.6, tilt: -1.0, zoom: 1 };
  let at = { ...START }, wanted = false;
  const seen = new Float32Array(nodes.length), depth = new Float32Array(count);
  const angles = () => [Math.cos(at.turn), Math.sin(at.turn), Math.cos(at.tilt), Math.sin(at.tilt)];
  // Half width and half height of what is first seen, so that all of it fits.
  const half = [1, 1], [c0, s0, c1, s1] = angles();
  for (let i = 0; i < nodes.length; i += 3) {
    half[0] = Math.max(half[0], Math.abs(c0 * nodes[i] - s0 * nodes[i + 1]));
    half[1] = Math.max(half[1], Math.abs(c1 * (s0 * nodes[i] + c0 * nodes[i + 1]) - s1 * nodes[i + 2]));
  }

  function draw() {
    wanted = false;
    const scale = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
    canvas.width = Math.max(1, box.width * scale); canvas.height = Math.max(1, box.height * scale);
    const size = at.zoom * 0.46 * Math.min(canvas.width / half[0], canvas.height / half[1]);
    const [ct, st, cp, sp] = angles();
    for (let i = 0; i < nodes.length; i += 3) {
      const x = ct * nodes[i] - st * nodes[i + 1], y = st * nodes[i] + ct * nodes[i + 1], z = nodes[i + 2];
      seen[i] = canvas.width / 2 + size * x;
      seen[i + 1] = canvas.height / 2 - size * (cp * y - sp * z);
      seen[i + 2] = sp * y + cp * z; // towards the viewer
    }
    for (let f = 0; f < count; f++) {
      depth[f] = seen[3 * faces[3 * f] + 2] + seen[3 * faces[3 * f + 1] + 2] + seen[3 * faces[3 * f + 2] + 2];
    }
    const order = Array.from({ length: count }, (_, f) => f).sort((a, b) => depth[a] - depth[b]);
    pen.lineWidth = 0.5 * scale;
    pen.strokeStyle = "rgba(31, 41, 55, .45)";
    for (const f of order) {
      const [a, b, c] = [3 * faces[3 * f], 3 * faces[3 * f + 1], 3 * faces[3 * f + 2]];
      const ux = seen[b] - seen[a], uy = seen[b + 1] - seen[a + 1], uz = size * (seen[b + 2] - seen[a + 2]);
      const vx = seen[c] - seen[a], vy = seen[c + 1] - seen[a + 1], vz = size * (seen[c + 2] - seen[a + 2]);
      const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
      const light = 0.62 + 0.38 * Math.abs(nz) / (Math.hypot(nx, ny, nz) || 1);
      pen.fillStyle = `rgb(${colors[regions[f]].map((value) => value * light).join()})`;
      pen.beginPath();
      pen.moveTo(seen[a], seen[a + 1]); pen.lineTo(seen[b], seen[b + 1]); pen.lineTo(seen[c], seen[c + 1]);
      pen.closePath(); pen.fill(); pen.stroke();
    }
  }
  function change(turn, tilt, zoom) {
    at.turn += turn; at.tilt = Math.min(Math.PI, Math.max(-Math.PI, at.tilt + tilt));
    at.zoom = Math.min(20, Math.max(0.3, at.zoom * zoom));
    if (!wanted) { wanted = true; requestAnimationFrame(draw); }
  }
  const fingers = new Map(); // Pointers that are down, by number; a mouse is one.
  const pinch = () => {
    const [a, b] = [...fingers.values()];
    return { wide: Math.hypot(a.x - b.x, a.y - b.y), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 };
  };
  const place = (event) => ({ x: event.clientX, y: event.clientY });
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, place(event));
  });
  for (const over of ["pointerup", "pointercancel", "lostpointercapture"]) {
    canvas.addEventListener(over, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const from = fingers.get(event.pointerId);
    if (!from) return;
    const two = fingers.size === 2, before = two ? pinch() : from;
    fingers.set(event.pointerId, place(event));
    const after = two ? pinch() : fingers.get(event.pointerId);
    change((after.x - before.x) / 150, (after.y - before.y) / 150,
      two ? Math.max(1, after.wide) / Math.max(1, before.wide) : 1);
  });
  // Two fingers are the view's; what one does is said in the style sheet (touch-action).
  canvas.addEventListener("touchstart", (event) => {
    if (event.touches.length > 1) event.preventDefault();
  }, { passive: false });
  const hint = view.querySelector(".hint");
  let fading = 0;
  canvas.addEventListener("wheel", (event) => {
    if (event.ctrlKey || event.metaKey) {
      event.preventDefault(); hint.hidden = true; change(0, 0, Math.exp(-event.deltaY / 600));
      return;
    }
    hint.hidden = false; clearTimeout(fading);
    fading = setTimeout(() => { hint.hidden = true; }, 1200);
  }, { passive: false });
  const KEYS = {
    ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, -0.1, 1], ArrowDown: [0, 0.1, 1],
    "+": [0, 0, 1.15], "-": [0, 0, 1 / 1.15],
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.key === "0") at = { ...START };
    else if (!KEYS[event.key]) return;
    event.preventDefault();
    change(...(KEYS[event.key] ?? [0, 0, 1]));
  });
  view.hidden = false;
  view.parentElement.classList.add("has-view"); // hides the still picture on screens
  new ResizeObserver(() => change(0, 0, 1)).observe(canvas);
}
for (const button of document.querySelectorAll("button.open-all")) {
  button.hidden = document.querySelector("details") === null;
  button.addEventListener("click", () => {
    const folded = [...document.querySelectorAll("details")], open = folded.some((block) => !block.open);
    for (const block of folded) block.open = open;
    button.textContent = open ? "Fold all" : "Open all";
  });
}
