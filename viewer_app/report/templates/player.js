"use strict";
// Plays S_A, S_B and S*. The format of the data is described in viewer_app/report/motion.py.
(async () => {
const canvas = document.getElementById("person"), player = document.getElementById("player");
const play = document.getElementById("play"), slider = document.getElementById("moment");
const clock = document.getElementById("clock"), list = document.getElementById("events");
const [back, on, speed, loop, follow, large, quality, why] =
  ["back", "on", "speed", "loop", "follow", "large", "quality", "why"].map(id => document.getElementById(id));
const stretches = [...quality.querySelectorAll("i")], mark = quality.querySelector("b");
const shown = [...player.querySelectorAll(".key input")];
const jumps = [...list.querySelectorAll("button")];
const parents = JSON.parse(canvas.dataset.parents), sensors = JSON.parse(canvas.dataset.sensors);
const film = JSON.parse(document.getElementById("film")?.textContent ?? "{}"), late = 0.25;  // seconds
const colors = ["--s-a", "--s-b", "--fused"], widths = [0.012, 0.012, 0.03];  // metres
const count = +canvas.dataset.frames, series = 3 * parents.length * 3, distance = 6;  // metres to the eye
const unseen = -32768;

let seconds, positions, uncertain;
try {
  [seconds, positions, uncertain] = await decoded();
} catch (error) {
  clock.textContent = "This browser is too old to play the skeletons.";
  return;
}
const end = seconds[count - 1], centres = followed();
let time = 0, playing = false, before = 0, turn = between(), tilt = 0.2, here = null, stays = null;
for (const control of [play, slider, back, on, speed, loop, follow, ...jumps, ...shown]) control.disabled = false;
large.disabled = !document.fullscreenEnabled;
slider.max = end;
mark.style.display = "block";
go(+canvas.dataset.start);

async function decoded() {
  const packed = Uint8Array.from(atob(canvas.dataset.motion), letter => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const data = new DataView(await new Response(stream).arrayBuffer());
  const times = new Float32Array(count), values = new Int16Array(series * count);
  for (let k = 0; k < count; k++) times[k] = data.getFloat32(4 * k, true);
  for (let k = 0, low = 4 * count, high = low + values.length; k < values.length; k++) {
    const code = data.getUint8(low + k) | data.getUint8(high + k) << 8;
    values[k] = (k % count ? values[k - 1] : 0) + ((code >>> 1) ^ -(code & 1));
  }
  const bits = new Uint8Array(data.buffer, 4 * count + 2 * values.length);
  return [times, values, bits];
}

// Whether a joint of S* is uncertain, or has no data.
function doubtful(joint, frame) {
  const bit = joint * count + frame;
  return uncertain[bit >> 3] >> (7 - (bit & 7)) & 1;
}

// A joint's place in metres; null where it was not seen.
function place(skeleton, joint, frame) {
  const at = axis => positions[((skeleton * parents.length + joint) * 3 + axis) * count + frame];
  return at(0) === unseen ? null : [at(0) / 1000, at(1) / 1000, at(2) / 1000];
}

// What the eye looks at in each frame: it follows the root of S* along the floor.
function followed() {
  const root = parents.indexOf(-1), track = [];
  let x, z;
  for (let k = 0; k < count; k++) {
    const point = place(2, root, k);
    if (point) {
      const share = x === undefined ? 1 : Math.min(1, 2 * (seconds[k] - seconds[k - 1]));
      x = share === 1 ? point[0] : x + share * (point[0] - x);
      z = share === 1 ? point[2] : z + share * (point[2] - z);
    }
    track.push([x ?? sensors[0][0], z ?? sensors[0][2] + 2.5]);
  }
  return track;
}

// Unit vectors along the floor from a point to the sensors.
function directions([x, z]) {
  return sensors.map(at => {
    const size = Math.hypot(at[0] - x, at[2] - z) || 1;
    return [(at[0] - x) / size, (at[2] - z) / size];
  });
}

// The turn with which the eye stands between the sensors, or opposite: A is on the left, as in the viewer.
function between() {
  const [a, b] = directions(centres[0]), turn = Math.atan2(a[0] + b[0], -(a[1] + b[1]));
  const right = Math.cos(turn) * (a[0] - b[0]) + Math.sin(turn) * (a[1] - b[1]);  // of A from B
  return right > 0 ? turn + Math.PI : turn;
}

function frameAt(moment) {
  let low = 0, high = count - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (seconds[middle] <= moment + 0.001) low = middle; else high = middle - 1;
  }
  return low;
}

function go(moment) {
  time = Math.min(Math.max(moment, 0), end);
  slider.value = time;
  clock.textContent = `${time.toFixed(2)} of ${end.toFixed(2)} s`;
  slider.setAttribute("aria-valuetext", clock.textContent);
  mark.style.left = `${end ? 100 * time / end : 0}%`;
  why.textContent = stretches.findLast(each => +each.dataset.at <= time + 0.001).title;
  const latest = jumps.findLast(each => +each.dataset.at <= time + 0.001);
  if (latest !== here) {
    here?.closest("tr").removeAttribute("aria-current");
    here = latest;
    const row = here?.closest("tr");
    row?.setAttribute("aria-current", "true");
    list.scrollTop = row ? row.offsetTop - list.clientHeight / 2 : 0;
  }
  for (const figure of document.querySelectorAll(".film figure")) showImage(figure);
  draw();
}

// The image that is nearest in time to the skeletons, with its age where that is long.
function showImage(figure) {
  const now = seconds[frameAt(time)], [image, words] = figure.children;
  const apart = each => Math.abs(each[0] - now);
  const [at, jpeg] = film[figure.dataset.side].reduce((best, each) => apart(each) < apart(best) ? each : best);
  const off = at - now, isLate = Math.abs(off) > late;
  if (image.dataset.at !== String(at)) {
    image.dataset.at = at;
    image.src = `data:image/jpeg;base64,${jpeg}`;
  }
  image.classList.toggle("late", isLate);
  const when = isLate ? `${Math.abs(off).toFixed(1)} s ${off < 0 ? "old" : "later"}` : `at ${at.toFixed(2)} s`;
  words.textContent = `${figure.dataset.side.toUpperCase()} ${when}`;
}

function step(now) {
  if (!playing) return;
  const next = time + speed.value * (now - before) / 1000;
  before = now;
  go(next >= end && loop.checked ? 0 : next);
  if (time >= end) pause(); else requestAnimationFrame(step);
}

function stepFrames(frames) {
  if (playing) pause();
  go(seconds[Math.min(Math.max(frameAt(time) + frames, 0), count - 1)]);
}

function pause() {
  playing = false;
  play.textContent = "Play";
}

function draw() {
  const scale = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const pen = canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
  const frame = frameAt(time), centre = stays ?? centres[frame], metre = Math.min(width / 2, height / 2.5);
  const [cos, sin, down, flat] = [Math.cos(turn), Math.sin(turn), Math.sin(tilt), Math.cos(tilt)];
  const project = ([x, y, z]) => {
    const across = cos * (x - centre[0]) + sin * (z - centre[1]), depth = cos * (z - centre[1]) - sin * (x - centre[0]);
    const size = metre * distance / (distance + flat * depth + down * (y + 0.9));
    return [width / 2 + size * across, height / 2 + size * (flat * (y + 0.95) - down * depth), size];
  };
  const line = (from, to, thick) => {
    const [start, stop] = [project(from), project(to)];
    pen.lineWidth = Math.max(1, thick * (start[2] + stop[2]) / 2);
    pen.beginPath();
    pen.moveTo(start[0], start[1]);
    pen.lineTo(stop[0], stop[1]);
    pen.stroke();
  };
  pen.scale(scale, scale);
  pen.lineCap = "round";
  pen.strokeStyle = style.getPropertyValue("--grid");
  const [left, near] = centre.map(at => Math.round(2 * at) / 2 - 1.5);
  for (let k = 0; k <= 3; k += 0.5) {
    line([left + k, 0, near], [left + k, 0, near + 3], 0);
    line([left, 0, near + k], [left + 3, 0, near + k], 0);
  }
  pen.font = "600 16px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  directions(centre).forEach(([x, z], k) => {  // an arrow on the floor to each sensor
    const at = away => [centre[0] + away * x, 0, centre[1] + away * z];
    pen.strokeStyle = pen.fillStyle = style.getPropertyValue(colors[k]);
    line(at(0.5), at(0.9), 0.02);
    pen.fillText("AB"[k], ...project(at(1.05)).slice(0, 2));
  });
  colors.forEach((color, skeleton) => {
    if (!shown[skeleton].checked) return;
    pen.strokeStyle = style.getPropertyValue(color);
    parents.forEach((parent, joint) => {
      const [from, to] = [parent, joint].map(each => each < 0 ? null : place(skeleton, each, frame));
      const thin = skeleton === 2 && (doubtful(joint, frame) || parent >= 0 && doubtful(parent, frame));
      pen.setLineDash(thin ? [7, 6] : []);
      if (from && to) line(from, to, thin ? 0 : widths[skeleton]);
    });
    pen.setLineDash([]);
  });
}

function look(right, down) {
  turn -= right;
  tilt = Math.min(1.5, Math.max(0, tilt + down));
  draw();
}

play.addEventListener("click", () => {
  if (playing) { pause(); return; }
  if (time >= end - 0.001) go(0);  // a slider's value is rounded
  playing = true;
  play.textContent = "Pause";
  before = performance.now();
  requestAnimationFrame(step);
});
slider.addEventListener("input", () => go(+slider.value));
back.addEventListener("click", () => stepFrames(-1));
on.addEventListener("click", () => stepFrames(1));
follow.addEventListener("change", () => { stays = follow.checked ? null : centres[frameAt(time)]; draw(); });
large.addEventListener("click", () => document.fullscreenElement ? document.exitFullscreen() : player.requestFullscreen());
for (const kind of ["pointerdown", "pointermove"]) {
  quality.addEventListener(kind, event => {
    if (!event.buttons) return;
    const box = quality.getBoundingClientRect();
    go((event.clientX - box.left) / box.width * end);
  });
}
for (const jump of jumps) {
  jump.addEventListener("click", () => {
    go(+jump.dataset.at);
    player.scrollIntoView({ block: "nearest" });
  });
}
for (const box of shown) box.addEventListener("change", draw);
canvas.addEventListener("pointerdown", event => canvas.setPointerCapture(event.pointerId));
canvas.addEventListener("pointermove", event => {
  if (event.buttons) look(event.movementX / 150, event.movementY / 150);
});
function faster(by) {
  speed.selectedIndex = Math.min(Math.max(speed.selectedIndex + by, 0), speed.length - 1);
}
const keys = { " ": () => play.click(), ",": () => stepFrames(-1), ".": () => stepFrames(1), "+": () => faster(1),
  "-": () => faster(-1), l: () => loop.click(), f: () => follow.click(), Enter: () => large.click(),
  Home: () => go(0), End: () => go(end) };
canvas.addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const does = keys[event.key] ?? keys[event.key.toLowerCase()];
  if (does) {
    event.preventDefault();
    does();
    return;
  }
  const [right, down] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] ?? [];
  if (right === undefined) return;
  event.preventDefault();
  look(right / 8, down / 8);
});
new ResizeObserver(draw).observe(canvas);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
})();
