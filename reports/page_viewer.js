// Heads that turn together: source, truth and results, with the error in mm as colour. Everything is on this page.

const FIELD_OF_VIEW = 14 * Math.PI / 180; // as in the report
const SMOOTH = devicePixelRatio < 2 ? 2 : 1; // pixels drawn for each pixel of a panel, along each axis
const BLEND = 350, STAY = 1500; // ms from one expression to the next, and of each while it plays

// ---- arrays, as reports/page_heads.py packs them ----

async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  const stream = new Blob([bytes.subarray(1)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = planes.length / bytes[0];
  const out = new Int32Array(count);
  for (let plane = 0; plane < bytes[0]; plane++)
    for (let i = 0; i < count; i++) out[i] |= planes[plane * count + i] << (8 * plane);
  for (let i = 0; i < count; i++) out[i] = (out[i] >>> 1) ^ -(out[i] & 1);
  return out;
}

function summed(steps) {
  for (let i = 1; i < steps.length; i++) steps[i] += steps[i - 1];
  return steps;
}

// Frames of (n, 3) integers, each vertex from the neighbour that came before it on the walk.
function walked(steps, walk) {
  const n = walk.order.length, frames = [];
  for (let start = 0; start < steps.length; start += 3 * n) {
    const along = steps.subarray(start, start + 3 * n), frame = new Int32Array(3 * n);
    for (let axis = 0; axis < 3; axis++) {
      const own = along.subarray(axis * n, axis * n + n);
      for (let i = 1; i < n; i++) own[i] += own[walk.before[i]];
      for (let i = 0; i < n; i++) frame[3 * walk.order[i] + axis] = own[i];
    }
    frames.push(frame);
  }
  return frames;
}

function added(a, b) {
  return a.map((x, i) => x + b[i]);
}

function vertexNormals(v, faces, out) {
  out.fill(0);
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const ux = v[b] - v[a], uy = v[b + 1] - v[a + 1], uz = v[b + 2] - v[a + 2];
    const wx = v[c] - v[a], wy = v[c + 1] - v[a + 1], wz = v[c + 2] - v[a + 2];
    const x = uy * wz - uz * wy, y = uz * wx - ux * wz, z = ux * wy - uy * wx; // by area
    for (const i of [a, b, c]) { out[i] += x; out[i + 1] += y; out[i + 2] += z; }
  }
}

// ---- drawing ----

const VERTEX = `#version 300 es
in vec3 position, normal;
in vec3 surface; // error in mm, 1 where it was measured, share of the sky that reaches the vertex
uniform mat3 turn;
uniform vec3 eye; // of the camera, in turned coordinates
uniform vec2 scale;
uniform vec2 range; // near, far
out vec3 facing, place;
out vec3 shown;
void main() {
  facing = turn * normal;
  place = turn * position - eye;
  shown = surface;
  float depth = -place.z;
  gl_Position = vec4(place.xy * scale, ((range.y + range.x) * depth - 2.0 * range.x * range.y) / (range.y - range.x), depth);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec3 facing, place;
in vec3 shown;
uniform vec3 skin, stops[11];
uniform float limit;
uniform bool mapped;
out vec4 color;
const vec3 KEY = vec3(-0.489, 0.538, 0.685), FILL = vec3(0.861, 0.051, 0.507), RIM = vec3(0.447, 0.546, -0.745);
void main() {
  vec3 n = normalize(facing), viewer = -normalize(place);
  bool inside = !gl_FrontFacing;
  if (inside) n = -n;
  float sky = 0.08 + 0.92 * shown.z, key = min(1.6 * sky, 1.0); // shadows of the key light are not traced
  float light = 0.74 * key * max(dot(n, KEY), 0.0)
              + (0.24 * max(dot(n, FILL), 0.0) + 0.44 * (0.7 + 0.3 * n.y) + 0.35 * max(dot(n, RIM), 0.0)) * sky;
  if (inside) light *= 0.35;
  bool colored = mapped && shown.y > 0.999;
  vec3 albedo = skin;
  if (colored) {
    float x = clamp(shown.x / limit, 0.0, 1.0) * 10.0;
    int i = int(min(x, 9.0));
    albedo = mix(stops[i], stops[i + 1], x - float(i));
    light = 0.25 * sky + 0.75 * min(light, 1.0);
  }
  vec3 lit = pow(albedo, vec3(2.2)) * light;
  if (!colored) lit += 0.06 * key * pow(max(dot(n, normalize(viewer + KEY)), 0.0), 24.0);
  color = vec4(pow(min(lit, 1.0), vec3(1.0 / 2.2)), 1.0);
}`;

const rgb = hex => [1, 3, 5].map(i => parseInt(hex.slice(i, i + 2), 16) / 255);

// One WebGL context draws every head; each is copied to the canvas of its panel.
class Painter {
  constructor(skin, stops) {
    this.canvas = document.createElement("canvas");
    const gl = this.gl = this.canvas.getContext("webgl2", { antialias: true, alpha: true });
    if (!gl) throw new Error("This browser offers no WebGL 2, so the heads cannot be shown. The tables below need none.");
    const program = this.program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS))
      throw new Error("The graphics driver refused the viewer's shaders: " + gl.getProgramInfoLog(program));
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    gl.uniform3fv(this.at("skin"), rgb(skin));
    gl.uniform3fv(this.at("stops"), stops.flatMap(rgb));
  }

  at(name) { return this.gl.getUniformLocation(this.program, name); }

  faces(indices) {
    const gl = this.gl;
    this.indices ??= gl.createBuffer();
    gl.bindVertexArray(null);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.indices);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint32Array.from(indices), gl.STATIC_DRAW);
    this.count = indices.length;
  }

  mesh() {
    const gl = this.gl, mesh = { array: gl.createVertexArray(), buffers: {} };
    gl.bindVertexArray(mesh.array);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.indices);
    for (const [name, size] of [["position", 3], ["normal", 3], ["surface", 3]]) {
      const place = gl.getAttribLocation(this.program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, mesh.buffers[name] = gl.createBuffer());
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, gl.FLOAT, false, 0, 0);
    }
    return mesh;
  }

  fill(mesh, arrays) {
    const gl = this.gl;
    for (const name in arrays) {
      gl.bindBuffer(gl.ARRAY_BUFFER, mesh.buffers[name]);
      gl.bufferData(gl.ARRAY_BUFFER, arrays[name], gl.DYNAMIC_DRAW);
    }
  }

  remove(mesh) {
    for (const name in mesh.buffers) this.gl.deleteBuffer(mesh.buffers[name]);
    this.gl.deleteVertexArray(mesh.array);
  }

  draw(mesh, canvas, camera, limit, mapped) {
    const gl = this.gl, width = SMOOTH * canvas.width, height = SMOOTH * canvas.height;
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const focal = 1 / Math.tan(FIELD_OF_VIEW / 2);
    gl.uniformMatrix3fv(this.at("turn"), true, camera.turn);
    gl.uniform3fv(this.at("eye"), camera.eye);
    gl.uniform2f(this.at("scale"), focal * height / width, focal);
    gl.uniform2f(this.at("range"), Math.max(camera.distance - 600, 5), camera.distance + 600);
    gl.uniform1f(this.at("limit"), limit);
    gl.uniform1i(this.at("mapped"), mapped ? 1 : 0);
    gl.bindVertexArray(mesh.array);
    gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.imageSmoothingQuality = "high";
    context.drawImage(this.canvas, 0, 0, canvas.width, canvas.height);
  }
}

// The one camera of all panels: it walks round the middle of the face.
class Orbit {
  constructor(view) { this.view = view; this.reset(); }

  reset() { Object.assign(this, { yaw: this.view[0], pitch: this.view[1], zoom: 1, right: 0, up: 0 }); }

  by(yaw, pitch) {
    this.yaw = (this.yaw + yaw + 540) % 360 - 180;
    this.pitch = Math.max(-89, Math.min(89, this.pitch + pitch));
  }

  closer(factor) { this.zoom = Math.max(0.4, Math.min(12, this.zoom * factor)); }

  camera(target, distance) {
    const a = this.yaw * Math.PI / 180, b = this.pitch * Math.PI / 180;
    const backward = [Math.sin(a) * Math.cos(b), Math.sin(b), Math.cos(a) * Math.cos(b)];
    const right = [Math.cos(a), 0, -Math.sin(a)];
    const up = [-Math.sin(a) * Math.sin(b), Math.cos(b), -Math.cos(a) * Math.sin(b)];
    const along = axis => axis[0] * target[0] + axis[1] * target[1] + axis[2] * target[2];
    const away = distance / this.zoom;
    return {
      turn: [...right, ...up, ...backward],
      eye: [along(right) + this.right, along(up) + this.up, along(backward) + away],
      distance: away,
    };
  }
}

// ---- the viewer ----

class Viewer {
  constructor(root, facts) {
    this.root = root;
    this.facts = facts;
    this.part = name => root.querySelector(`[data-part="${name}"]`);
    this.painter = new Painter(facts.skin, facts.colors);
    this.arrays = new Map();
    this.panels = new Map(); // by name of the column
    this.asked = 0;
    this.study = facts.studies[0];
    this.orbit = new Orbit(this.study.view);
    this.still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.wire();
  }

  array(id) {
    if (!this.arrays.has(id)) this.arrays.set(id, unpack(document.getElementById("array-" + id).textContent));
    return this.arrays.get(id);
  }

  once(key, make) {
    if (!this.arrays.has(key)) this.arrays.set(key, make());
    return this.arrays.get(key);
  }

  topology(study) {
    return this.once("topology " + study.order, async () => {
      const [order, before, faces, head] = await Promise.all(
        ["order", "before", "faces", "head"].map(async name => summed((await this.array(study[name])).slice())));
      return { order, before, faces, head };
    });
  }

  frames(id, walk) {
    return this.once("frames " + id, async () => walked((await this.array(id)).slice(), walk));
  }

  // Shapes in mm and errors of one column at every stop of the slider: the neutral, then each expression.
  async column(name, study, scene, count) {
    const walk = await this.topology(study), step = study.step;
    const millimetres = frame => Float32Array.from(frame, x => x * step);
    const [source, target] = await this.frames(scene.neutrals, walk);
    const [sourceSky, targetSky] = await Promise.all(scene.skies.map(id => this.sky(id, walk)));
    if (name === "source") {
      const motion = await this.frames(scene.motion, walk);
      return { shapes: [source, ...motion.map(m => added(source, m))].map(millimetres), surfaces: () => sourceSky };
    }
    const truth = (await this.frames(scene.truth, walk)).map(m => added(target, m));
    if (name === "truth") return { shapes: [target, ...truth].map(millimetres), surfaces: () => targetSky };
    const result = scene.results[count]?.[name];
    if (!result) return null;
    const deltas = await this.frames(result.delta, walk);
    const errors = [target.map(() => 0), ...deltas].map(delta => {
      const out = targetSky.slice();
      for (const i of walk.head) {
        out[3 * i] = step * Math.hypot(delta[3 * i], delta[3 * i + 1], delta[3 * i + 2]);
        out[3 * i + 1] = 1;
      }
      return out;
    });
    return {
      shapes: [target, ...deltas.map((delta, t) => added(truth[t], delta))].map(millimetres),
      surfaces: stop => errors[stop],
      result,
    };
  }

  // (error, measured, sky) of every vertex where nothing was measured.
  sky(id, walk) {
    return this.once("sky " + id, async () => {
      const shares = summed((await this.array(id)).slice()), out = new Float32Array(3 * shares.length);
      walk.order.forEach((vertex, i) => { out[3 * vertex + 2] = shares[i] / 255; });
      return out;
    });
  }

  wire() {
    const part = this.part;
    const options = (select, names) => select.replaceChildren(...names.map((name, i) => new Option(name, i)));
    options(part("conditions"), this.facts.studies.map(study => study.label || "all"));
    part("conditions").closest("label").hidden = this.facts.studies.length < 2;
    part("conditions").onchange = () => this.choose(this.facts.studies[part("conditions").value]);
    part("pair").onchange = () => this.show();
    part("counts").onchange = () => this.show();
    part("methods").onchange = () => this.show();
    part("map").onchange = () => this.paint();
    part("expression").oninput = () => this.go(Number(part("expression").value));
    part("play").onclick = () => this.play(!this.playing);
    part("reset").onclick = () => { this.orbit.reset(); this.paint(); };
    new ResizeObserver(() => this.paint()).observe(part("panels"));
    matchMedia("(resolution: 1dppx)").addEventListener?.("change", () => this.paint());
    this.choose(this.study);
  }

  choose(study) {
    const part = this.part, chip = (kind, group, value, text, checked, color) => {
      const label = document.createElement("label"), input = document.createElement("input");
      Object.assign(input, { type: kind, name: group, value, checked });
      const words = document.createElement("span");
      words.textContent = text;
      if (color) words.style.setProperty("--swatch", color);
      label.append(input, words);
      return label;
    };
    this.study = study;
    const scenes = study.scenes;
    part("pair").replaceChildren(...scenes.map((scene, i) => {
      const draws = scenes.filter(s => s.source === scene.source && s.target === scene.target).length > 1;
      return new Option(`${scene.source} \u2192 ${scene.target}${draws ? `, draw ${scene.draw}` : ""}`, i);
    }));
    const chips = (name, made) => part(name).replaceChildren(part(name).querySelector("legend"), ...made);
    chips("counts", study.counts.map((count, i) => chip("radio", "count", count, count, i === 0)));
    chips("methods", study.methods.map(method =>
      chip("checkbox", "method", method.name, method.label, study.shown.includes(method.name), method.color)));
    part("left-out").textContent = study.left_out;
    part("ends").replaceChildren(...[0, study.limit / 2, study.limit].map((value, i) => {
      const end = document.createElement("span");
      end.textContent = (i === 2 ? "\u2265 " : "") + Number(value.toPrecision(3)) + (i === 2 ? " mm" : "");
      return end;
    }));
    part("bar").style.background = `linear-gradient(to right, ${this.facts.colors.join(",")})`;
    for (const panel of this.panels.values()) this.close(panel);
    this.panels.clear();
    this.show();
  }

  get scene() { return this.study.scenes[this.part("pair").value]; }

  get count() { return this.part("counts").querySelector(":checked").value; }

  async show() {
    const asked = ++this.asked, { study, scene, count, part } = this;
    this.state("busy");
    const chosen = Array.from(part("methods").querySelectorAll(":checked"), input => input.value);
    const names = ["source", "truth", ...chosen];
    const slider = part("expression");
    slider.max = scene.expressions.length;
    if (!this.started) { slider.value = scene.liveliest; this.started = true; }
    const stop = Number(slider.value);
    const walk = await this.topology(study);
    const columns = await Promise.all(names.map(name => this.column(name, study, scene, count)));
    if (asked !== this.asked) return;
    if (this.walk !== walk) this.painter.faces((this.walk = walk).faces);
    for (const [name, panel] of this.panels) if (!names.includes(name)) { this.close(panel); this.panels.delete(name); }
    names.forEach((name, i) => {
      const panel = this.panels.get(name) ?? this.open(name);
      panel.column = columns[i];
      panel.from = panel.to = null;
    });
    part("panels").replaceChildren(...names.map(name => this.panels.get(name).figure));
    this.go(stop, false);
  }

  open(name) {
    const method = this.study.methods.find(m => m.name === name);
    const figure = document.createElement("figure"), canvas = document.createElement("canvas");
    const title = document.createElement("strong"), said = document.createElement("span"), mean = document.createElement("small");
    const caption = document.createElement("figcaption");
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    figure.dataset.column = name;
    if (method) title.style.setProperty("--swatch", method.color);
    caption.append(title, said, mean);
    figure.append(canvas, caption);
    const panel = { name, method, figure, canvas, title, said, mean, mesh: this.painter.mesh() };
    this.panels.set(name, panel);
    this.steer(canvas);
    return panel;
  }

  close(panel) {
    this.painter.remove(panel.mesh);
    panel.figure.remove();
  }

  // To a stop of the slider, by way of the shapes between, which are for the eye alone.
  go(stop, blend = true) {
    this.stop = stop;
    this.part("expression").value = stop;
    this.name();
    for (const panel of this.panels.values()) {
      if (!panel.column) continue;
      panel.to = { shape: panel.column.shapes[stop], surface: panel.column.surfaces(stop) };
      panel.from = blend && !this.still && panel.now ? panel.now : panel.to;
    }
    this.began = blend && !this.still ? performance.now() : -Infinity;
    this.state("busy");
    if (!this.moving) { this.moving = true; requestAnimationFrame(() => this.move()); }
  }

  move() {
    const t = Math.min((performance.now() - this.began) / BLEND, 1), s = t * t * (3 - 2 * t);
    const between = (a, b) => s === 1 || a === b ? b : a.map((x, i) => x + s * (b[i] - x));
    for (const panel of this.panels.values()) {
      if (!panel.column || !panel.to) continue;
      panel.now = { shape: between(panel.from.shape, panel.to.shape), surface: between(panel.from.surface, panel.to.surface) };
      panel.normals ??= new Float32Array(panel.now.shape.length);
      vertexNormals(panel.now.shape, this.walk.faces, panel.normals);
      this.painter.fill(panel.mesh, { position: panel.now.shape, normal: panel.normals, surface: panel.now.surface });
    }
    this.paint();
    this.moving = t < 1;
    if (this.moving) requestAnimationFrame(() => this.move());
    else this.state("still");
  }

  name() {
    const { scene, count, stop, part } = this, total = scene.expressions.length;
    const expression = stop ? scene.expressions[stop - 1] : "neutral";
    const words = stop ? `${expression} (${stop} of ${total})` : `neutral (0 of ${total})`;
    part("name").textContent = words;
    part("expression").setAttribute("aria-valuetext", words);
    for (const panel of this.panels.values()) {
      const person = { source: scene.source, truth: scene.target }[panel.name];
      const label = panel.method?.label ?? panel.name, result = panel.column?.result;
      panel.title.textContent = label;
      const missing = panel.method && !result;
      panel.figure.classList.toggle("missing", Boolean(missing));
      panel.said.textContent = person ?? (missing ? "no result" : stop ? `${result.errors[stop - 1]} mm` : "neutral");
      panel.mean.textContent = result ? `all ${total}: ${result.mean} mm` : "\u00a0";
      panel.canvas.setAttribute("aria-label",
        `${label}, ${expression}${panel.method ? `, ${count} examples: ${panel.said.textContent}` : ` of ${person}`}. ` +
        "Arrow keys turn, plus and minus zoom, 0 resets.");
    }
  }

  paint() {
    const { scene, study, part } = this;
    if (!this.walk) return;
    const camera = this.orbit.camera(scene.target_point, scene.distance), ratio = Math.min(devicePixelRatio || 1, 2);
    for (const panel of this.panels.values()) {
      const box = panel.canvas.getBoundingClientRect();
      const width = Math.max(Math.round(box.width * ratio), 1), height = Math.max(Math.round(box.height * ratio), 1);
      if (panel.canvas.width !== width || panel.canvas.height !== height) Object.assign(panel.canvas, { width, height });
      if (panel.column && panel.now)
        this.painter.draw(panel.mesh, panel.canvas, camera, study.limit, Boolean(panel.method) && part("map").checked);
      else panel.canvas.getContext("2d").clearRect(0, 0, width, height);
    }
  }

  soon() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.paint(); });
  }

  state(name) { this.root.dataset.state = name; }

  play(on) {
    this.playing = on;
    this.part("play").textContent = on ? "Pause" : "Play";
    clearInterval(this.timer);
    const next = () => this.go((this.stop + 1) % (this.scene.expressions.length + 1));
    if (on) { next(); this.timer = setInterval(next, STAY); }
  }

  steer(canvas) {
    const orbit = this.orbit, at = new Map(); // pointers that are down
    const pan = (dx, dy) => {
      const perPixel = 2 * Math.tan(FIELD_OF_VIEW / 2) * this.scene.distance / orbit.zoom / canvas.clientHeight;
      orbit.right -= dx * perPixel;
      orbit.up += dy * perPixel;
    };
    const apart = () => { const [a, b] = at.values(); return Math.hypot(a.x - b.x, a.y - b.y); };
    canvas.onpointerdown = event => {
      canvas.setPointerCapture(event.pointerId);
      at.set(event.pointerId, { x: event.clientX, y: event.clientY });
    };
    canvas.onpointermove = event => {
      const old = at.get(event.pointerId);
      if (!old) return;
      const dx = event.clientX - old.x, dy = event.clientY - old.y, before = at.size > 1 ? apart() : 0;
      at.set(event.pointerId, { x: event.clientX, y: event.clientY });
      if (at.size > 1) { orbit.closer(apart() / Math.max(before, 1)); pan(dx / 2, dy / 2); }
      else if (event.shiftKey || event.buttons > 1) pan(dx, dy);
      else orbit.by(-0.5 * dx, 0.5 * dy);
      this.soon();
    };
    canvas.onpointerup = canvas.onpointercancel = event => at.delete(event.pointerId);
    canvas.oncontextmenu = event => event.preventDefault();
    canvas.ondblclick = () => { orbit.reset(); this.soon(); };
    canvas.addEventListener("wheel", event => {
      if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls
      event.preventDefault();
      orbit.closer(Math.exp(-0.0015 * event.deltaY * (event.deltaMode ? 30 : 1)));
      this.soon();
    }, { passive: false });
    const keys = {
      ArrowLeft: () => orbit.by(-5, 0), ArrowRight: () => orbit.by(5, 0), ArrowUp: () => orbit.by(0, 5),
      ArrowDown: () => orbit.by(0, -5), "+": () => orbit.closer(1.15), "=": () => orbit.closer(1.15),
      "-": () => orbit.closer(1 / 1.15), 0: () => orbit.reset(),
    };
    canvas.onkeydown = event => {
      if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      keys[event.key]();
      this.soon();
    };
  }
}

function startViewer() {
  const root = document.getElementById("viewer");
  if (!root) return;
  const said = root.querySelector('[data-part="said"]');
  const fail = words => {
    root.dataset.state = "failed";
    said.textContent = words;
    said.hidden = false;
    root.querySelector('[data-part="stage"]').hidden = true;
  };
  if (typeof DecompressionStream === "undefined")
    return fail("This browser is too old to unpack the heads: Chrome 80, Firefox 113 or Safari 16.4 and later can. The tables below need nothing of it.");
  addEventListener("unhandledrejection", event => fail("The heads cannot be shown: " + event.reason));
  try {
    new Viewer(root, JSON.parse(document.getElementById("heads").textContent));
  } catch (error) {
    fail(error.message);
  }
}
