"use strict";
// A small WebGL viewer: tubes as instanced capsules, a translucent surface, parallel projection, layers to switch.
(() => {
  const TUBE = `#version 300 es
    layout(location=0) in vec4 corner;            // unit normal in the tube's frame, 0 or 1 for its end
    layout(location=1) in vec3 from;
    layout(location=2) in vec3 to;
    layout(location=3) in float radius;
    uniform mat3 turn; uniform vec3 centre, low, size; uniform vec2 scale; uniform float depth, thickest, pixel;
    out vec3 normal;
    void main() {
      vec3 a = low + from * size, b = low + to * size, d = b - a;
      vec3 w = dot(d, d) > 0.0 ? normalize(d) : vec3(0.0, 0.0, 1.0);
      vec3 u = normalize(cross(w, abs(w.x) < 0.7 ? vec3(1.0, 0.0, 0.0) : vec3(0.0, 1.0, 0.0)));
      vec3 n = corner.x * u + corner.y * cross(w, u) + corner.z * w;
      vec3 p = turn * (mix(a, b, corner.w) + max(radius * thickest, 0.6 * pixel) * n - centre);
      normal = turn * n;
      gl_Position = vec4(p.xy * scale, -p.z * depth, 1.0);
    }`;
  const SURFACE = `#version 300 es
    layout(location=0) in vec3 point;
    layout(location=1) in vec3 direction;
    uniform mat3 turn; uniform vec3 centre, low, size; uniform vec2 scale; uniform float depth, nearer;
    out vec3 normal;
    void main() {
      vec3 p = turn * (low + point * size - centre) + vec3(0.0, 0.0, nearer);
      normal = turn * direction;
      gl_Position = vec4(p.xy * scale, -p.z * depth, 1.0);
    }`;
  const SHADE = `#version 300 es
    precision highp float;
    in vec3 normal; uniform vec3 colour; uniform float veil; out vec4 shown;
    void main() {
      vec3 n = normalize(normal);
      float facing = abs(n.z);
      float light = 0.5 + 0.5 * clamp(0.85 * facing + 0.25 * n.y - 0.1 * n.x, 0.0, 1.0);
      float alpha = veil > 0.0 ? veil * mix(1.0, 0.4, facing * facing) : 1.0;
      shown = vec4(colour * light * alpha, alpha);
    }`;

  const holder = document.getElementById("viewer");
  const text = document.getElementById("scene-data");
  if (!holder || !text) return;
  const canvas = holder.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { antialias: true, premultipliedAlpha: true });
  if (!gl) return;
  const scene = JSON.parse(text.textContent);

  function bytes(base64) {
    return Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
  }
  function compile(vertex) {
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, SHADE]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    return gl.getProgramParameter(program, gl.LINK_STATUS) ? program : null;
  }
  function buffer(target, data) {
    const made = gl.createBuffer();
    gl.bindBuffer(target, made);
    gl.bufferData(target, data, gl.STATIC_DRAW);
    return made;
  }

  const programs = { tubes: compile(TUBE), surface: compile(SURFACE) };
  if (!programs.tubes || !programs.surface) return;

  function capsule() {
    const sides = 10, rings = [[-1, 0, 0], [-0.7071, 0.7071, 0], [0, 1, 0], [0, 1, 1], [0.7071, 0.7071, 1], [1, 0, 1]];
    const corners = [], index = [];
    rings.forEach(([along, across, end], r) => {
      for (let k = 0; k < sides; k++) {
        const angle = (2 * Math.PI * k) / sides;
        corners.push(across * Math.cos(angle), across * Math.sin(angle), along, end);
        if (r) {
          const a = (r - 1) * sides + k, b = (r - 1) * sides + ((k + 1) % sides);
          index.push(a, b, a + sides, b, b + sides, a + sides);
        }
      }
    });
    return { corners: new Float32Array(corners), index: new Uint16Array(index) };
  }
  const shape = capsule();
  const cornerBuffer = buffer(gl.ARRAY_BUFFER, shape.corners);

  function tubes(layer) {
    const data = bytes(layer.data);
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, cornerBuffer);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 4, gl.FLOAT, false, 0, 0);
    buffer(gl.ARRAY_BUFFER, data);
    [[1, 3, 0], [2, 3, 6], [3, 1, 12]].forEach(([place, n, offset]) => {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, n, gl.UNSIGNED_SHORT, true, 14, offset);
      gl.vertexAttribDivisor(place, 1);
    });
    buffer(gl.ELEMENT_ARRAY_BUFFER, shape.index);
    gl.bindVertexArray(null);
    return { ...layer, array, count: data.length / 14 };
  }

  function normals(points, triangles, size) {
    const sum = new Float32Array(points.length);
    for (let t = 0; t < triangles.length; t += 3) {
      const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
      const u = [0, 1, 2].map((k) => (points[b + k] - points[a + k]) * size[k]);
      const v = [0, 1, 2].map((k) => (points[c + k] - points[a + k]) * size[k]);
      const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      for (const at of [a, b, c]) for (let k = 0; k < 3; k++) sum[at + k] += n[k];
    }
    for (let i = 0; i < sum.length; i += 3) {
      const length = Math.hypot(sum[i], sum[i + 1], sum[i + 2]) || 1;
      for (let k = 0; k < 3; k++) sum[i + k] /= length;
    }
    return sum;
  }

  function surface(layer) {
    const points = new Uint16Array(bytes(layer.points).buffer);
    const triangles = new Uint32Array(bytes(layer.triangles).buffer);
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    buffer(gl.ARRAY_BUFFER, points);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.UNSIGNED_SHORT, true, 0, 0);
    buffer(gl.ARRAY_BUFFER, normals(points, triangles, scene.size));
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 3, gl.FLOAT, false, 0, 0);
    buffer(gl.ELEMENT_ARRAY_BUFFER, triangles);
    gl.bindVertexArray(null);
    return { ...layer, array, count: triangles.length };
  }

  const layers = scene.layers.map((layer) => (layer.kind === "surface" ? surface(layer) : tubes(layer)));
  const centre = scene.low.map((low, k) => low + scene.size[k] / 2);
  const reach = Math.hypot(...scene.size);
  let view;
  function reset() {
    view = { turn: scene.axes.map((row) => row.slice()), zoom: 1, centre: centre.slice() };
  }
  function fitted() {
    const aspect = canvas.clientWidth / Math.max(canvas.clientHeight, 1);
    return Math.max(scene.half[1], scene.half[0] / aspect) / view.zoom; // half of the height that is seen, in mm
  }

  function draw() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [w, h] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    gl.viewport(0, 0, w, h);
    gl.clearColor(1, 1, 1, 1);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const half = fitted();
    for (const kind of ["tubes", "surface"]) {
      const program = programs[kind];
      const at = (name) => gl.getUniformLocation(program, name);
      gl.useProgram(program);
      gl.uniformMatrix3fv(at("turn"), true, view.turn.flat());
      gl.uniform3fv(at("centre"), view.centre);
      gl.uniform3fv(at("low"), scene.low);
      gl.uniform3fv(at("size"), scene.size);
      gl.uniform2f(at("scale"), h / w / half, 1 / half);
      gl.uniform1f(at("depth"), 0.5 / Math.max(reach, half));
      if (kind === "surface") {
        gl.enable(gl.BLEND);
        gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
        gl.depthMask(false);
      } else {
        gl.disable(gl.BLEND);
        gl.uniform1f(at("thickest"), scene.thickest);
        gl.uniform1f(at("pixel"), (2 * half) / h);
      }
      for (const layer of layers) {
        if (layer.kind !== kind || layer.hidden || !layer.count) continue;
        gl.uniform3fv(at("colour"), layer.colour);
        gl.uniform1f(at("veil"), kind === "surface" ? 0.55 : 0);
        if (kind === "surface") gl.uniform1f(at("nearer"), layer.nearer);
        gl.bindVertexArray(layer.array);
        if (kind === "surface") gl.drawElements(gl.TRIANGLES, layer.count, gl.UNSIGNED_INT, 0);
        else gl.drawElementsInstanced(gl.TRIANGLES, shape.index.length, gl.UNSIGNED_SHORT, 0, layer.count);
      }
    }
    gl.bindVertexArray(null);
    bar(half);
  }

  function bar(half) {
    const perPixel = (2 * half) / canvas.clientHeight;
    const target = 120 * perPixel;
    const power = 10 ** Math.floor(Math.log10(target));
    const length = power * [5, 2, 1].find((step) => step * power <= target);
    holder.querySelector(".bar").style.width = `${length / perPixel}px`;
    holder.querySelector(".length").textContent = `${Number(length.toPrecision(1))} mm`;
  }

  let asked = false;
  function redraw() {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      draw();
    });
  }
  function rotate(right, up) {
    const [ca, sa, cb, sb] = [Math.cos(right), Math.sin(right), Math.cos(up), Math.sin(up)];
    const by = [[ca, 0, sa], [sb * sa, cb, -sb * ca], [-cb * sa, sb, cb * ca]];
    view.turn = by.map((row) => [0, 1, 2].map((k) => row[0] * view.turn[0][k] + row[1] * view.turn[1][k] + row[2] * view.turn[2][k]));
    redraw();
  }
  function move(dx, dy) {
    const mm = (2 * fitted()) / canvas.clientHeight;
    for (let k = 0; k < 3; k++) view.centre[k] += mm * (-dx * view.turn[0][k] + dy * view.turn[1][k]);
    redraw();
  }
  function zoom(factor) {
    view.zoom = Math.min(200, Math.max(0.3, view.zoom * factor));
    redraw();
  }

  const fingers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) return;
    const now = [event.clientX, event.clientY];
    const [dx, dy] = [now[0] - last[0], now[1] - last[1]];
    if (fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
      zoom(apart(now) / apart(last));
      move(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons === 2) move(dx, dy);
    else rotate(dx * 0.008, dy * 0.008);
    fingers.set(event.pointerId, now);
  });
  for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("pointerleave", (event) => {
    if (event.pointerType === "mouse" && !event.buttons) canvas.blur();
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas && !event.ctrlKey) return; // the page scrolls until the view is clicked
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.0015));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const act = {
      ArrowLeft: () => rotate(-0.1, 0), ArrowRight: () => rotate(0.1, 0), ArrowUp: () => rotate(0, -0.1),
      ArrowDown: () => rotate(0, 0.1), "+": () => zoom(1.2), "=": () => zoom(1.2), "-": () => zoom(1 / 1.2),
      0: () => { reset(); redraw(); },
    }[event.key];
    if (act) {
      event.preventDefault();
      act();
    }
  });
  holder.querySelectorAll("input[data-layer]").forEach((box) => {
    const set = () => { layers[box.dataset.layer].hidden = !box.checked; redraw(); };
    box.addEventListener("change", set);
    set();
  });
  holder.querySelector("[data-act=reset]").addEventListener("click", () => { reset(); redraw(); });
  reset();
  holder.hidden = false;
  document.documentElement.classList.add("live");
  new ResizeObserver(redraw).observe(canvas);
  redraw();
})();
