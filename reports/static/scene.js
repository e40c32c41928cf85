// Shows a fruit's glTF in a dialog, to be turned by mouse, finger or keys; needs WebGL 2, else a word says so.
"use strict";
(function () {
  const dialog = document.getElementById("scene");
  if (!dialog || !dialog.showModal) return;
  const canvas = dialog.querySelector("canvas");
  const lacking = dialog.querySelector(".lacking");
  const choice = dialog.querySelector("select"), bar = dialog.querySelector(".bar"), unseen = dialog.querySelector(".unseen");
  const cut = dialog.querySelector("input"), scale = dialog.querySelector(".scale"), ends = dialog.querySelectorAll(".end");
  const BARS_MM = [1, 2, 5, 10, 20, 50, 100], FLESH = [0.98, 0.84, 0.55, 1];
  let gl = null, uniforms = null, scene = null, parts = [], current = null, low = [], high = [], middle = [0, 0, 0], reach = 1, yaw = 0.6, pitch = 0.35, zoom = 1;

  // parts with their sets of colours; the second set is a map, with its name and the ends of its bar
  function sceneOf(coded) {
    const bytes = Uint8Array.from(atob(coded), (one) => one.charCodeAt(0));
    const length = new DataView(bytes.buffer).getUint32(12, true);
    const gltf = JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + length)));
    const start = 28 + length;
    const read = (k) => {
      const accessor = gltf.accessors[k];
      const kind = { 5121: Uint8Array, 5123: Uint16Array, 5126: Float32Array }[accessor.componentType];
      const wide = { SCALAR: 1, VEC3: 3, VEC4: 4 }[accessor.type];
      const at = start + gltf.bufferViews[accessor.bufferView].byteOffset;
      return new kind(bytes.slice(at, at + accessor.count * wide * kind.BYTES_PER_ELEMENT).buffer);
    };
    const parts = gltf.meshes.flatMap((mesh) => mesh.primitives.map((one) => ({
      place: read(one.attributes.POSITION), corner: read(one.indices),
      colours: ["COLOR_0", "COLOR_1"].filter((name) => name in one.attributes).map((name) => read(one.attributes[name])),
    })));
    const extra = (name) => gltf.meshes.map((mesh) => mesh.extras && mesh.extras[name]).find(Boolean);
    const photo = extra("photo"), view = photo && gltf.bufferViews[gltf.images[photo.image].bufferView];
    return {
      parts, map: extra("map"), photo, named: extra("stem_and_suture"),
      jpeg: photo && new Blob([bytes.subarray(start + view.byteOffset, start + view.byteOffset + view.byteLength)], { type: "image/jpeg" }),
    };
  }

  function begun() {
    gl = canvas.getContext("webgl2", { antialias: true, alpha: true, stencil: true });
    if (!gl) return false;
    const program = gl.createProgram();
    const add = (kind, text) => {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, "#version 300 es\nprecision highp float;\n" + text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    };
    add(gl.VERTEX_SHADER, `in vec3 place; in vec4 colour; uniform mat3 turn; uniform vec3 middle; uniform vec3 scale;
      out vec3 seen; centroid out vec3 spot; out vec4 paint;
      void main() { seen = turn * (place - middle); spot = place; paint = colour;
        gl_Position = vec4(seen.xy * scale.xy, -seen.z * scale.z, 1.0); }`);
    add(gl.FRAGMENT_SHADER, `in vec3 seen; centroid in vec3 spot; in vec4 paint; out vec4 shown;
      uniform float from; uniform vec4 section; uniform vec3 eye; uniform bool photographed; uniform sampler2D photo;
      void main() {
        vec3 n = normalize(cross(dFdx(seen), dFdy(seen))), d = normalize(spot - eye);
        float light = 0.45 + 0.55 * abs(dot(n, normalize(vec3(-0.4, 0.5, 0.75))));
        if (spot.y < from) discard;
        if (section.a > 0.0) { shown = section; return; }
        vec4 c = paint;
        if (photographed) c = vec4(textureGrad(photo, vec2(atan(d.y, d.x) / 6.2831853, acos(d.z) / 3.1415927), vec2(0), vec2(0)).rgb, 1.0);
        if (photographed) light = 0.75 + 0.25 * light;
        if (from > -1e8) c.a = 1.0;
        shown = vec4(c.rgb * light * c.a, c.a); }`);
    gl.bindAttribLocation(program, 0, "place");
    gl.bindAttribLocation(program, 1, "colour");
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return false;
    gl.useProgram(program);
    uniforms = Object.fromEntries(["turn", "middle", "scale", "from", "section", "eye", "photographed"].map((name) => [name, gl.getUniformLocation(program, name)]));
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const [name, set] of [["MIN_FILTER", "LINEAR"], ["MAG_FILTER", "LINEAR"], ["WRAP_S", "REPEAT"], ["WRAP_T", "CLAMP_TO_EDGE"]]) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}`], gl[set]);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    return true;
  }

  function load() {
    [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    const name = choice.value === "photo" ? "" : choice.value;
    for (const part of parts) {
      gl.deleteVertexArray(part.array);
      part.buffers.forEach((buffer) => gl.deleteBuffer(buffer));
    }
    parts = scene.parts.map((part) => {
      const paint = name && part.colours[1] || part.colours[0], buffers = [0, 1, 2].map(() => gl.createBuffer());
      part.place.forEach((value, k) => {
        low[k % 3] = Math.min(low[k % 3], value);
        high[k % 3] = Math.max(high[k % 3], value);
      });
      const array = gl.createVertexArray();
      gl.bindVertexArray(array);
      [[part.place, 3, gl.FLOAT, false], [paint, 4, gl.UNSIGNED_BYTE, true]].forEach(([data, wide, kind, unit], k) => {
        gl.bindBuffer(gl.ARRAY_BUFFER, buffers[k]);
        gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
        gl.enableVertexAttribArray(k);
        gl.vertexAttribPointer(k, wide, kind, unit, 0, 0);
      });
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[2]);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, part.corner, gl.STATIC_DRAW);
      const solid = part.colours[0][3] === 255;
      return { array, buffers, count: part.corner.length, solid, section: solid ? Array.from(part.colours[0].slice(0, 4), (value) => value / 255) : FLESH };
    });
    middle = low.map((value, k) => (value + high[k]) / 2);
    reach = 0.6 * Math.max(...high.map((value, k) => value - low[k]));
    unseen.hidden = choice.value !== "photo";
    bar.hidden = !name;
    if (!name) return;
    const said = choice.selectedOptions[0].dataset;
    bar.firstElementChild.textContent = `${said.below} (${scene.map.low})`;
    bar.lastElementChild.textContent = `${said.above} (${scene.map.high})`;
  }

  function draw() {
    if (!gl) return;
    const [c, s, d, t] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
    // rows: to the right, up, towards the eye; the fruit's z is up
    const rows = [[c, s, 0], [-t * s, t * c, d], [d * s, -d * c, t]];
    gl.uniformMatrix3fv(uniforms.turn, true, rows.flat());
    gl.uniform3fv(uniforms.middle, middle);
    gl.uniform3f(uniforms.scale, zoom / reach * canvas.height / canvas.width, zoom / reach, 0.5 / reach);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const from = cut.value > 0 ? low[1] + (cut.value / 100) * (high[1] - low[1]) : -1e9, photographed = choice.value === "photo";
    gl.uniform1f(uniforms.from, from);
    const skin = parts.filter((part) => !part.solid), pit = parts.filter((part) => part.solid);
    const faces = (culled, of) => {
      gl.cullFace(culled);
      for (const part of of) drawn(part, photographed && !part.solid);
    };
    gl.disable(gl.BLEND);
    if (from > -1e8 || photographed) {
      faces(gl.BACK, parts);
      if (from > -1e8) [...skin, ...pit].forEach(filled);
    } else {
      faces(gl.BACK, pit);
      gl.enable(gl.BLEND);
      gl.depthMask(false);
      faces(gl.FRONT, skin);
      faces(gl.BACK, skin);
    }
    named(rows);
  }

  function drawn(part, photographed, section = [0, 0, 0, 0]) {
    gl.uniform1i(uniforms.photographed, photographed);
    gl.uniform4fv(uniforms.section, section);
    gl.bindVertexArray(part.array);
    gl.drawElements(gl.TRIANGLES, part.count, gl.UNSIGNED_SHORT, 0);
  }

  // A part's section: the plane is inside a closed surface where an odd number of its faces lie behind the plane
  function filled(part) {
    gl.disable(gl.CULL_FACE);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.STENCIL_TEST);
    gl.clear(gl.STENCIL_BUFFER_BIT);
    gl.stencilFunc(gl.ALWAYS, 0, 1);
    gl.stencilOp(gl.INVERT, gl.INVERT, gl.INVERT);
    gl.colorMask(false, false, false, false);
    drawn(part, false);
    gl.colorMask(true, true, true, true);
    gl.stencilFunc(gl.NOTEQUAL, 0, 1);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.KEEP);
    drawn(part, false, part.section);
    gl.disable(gl.STENCIL_TEST);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
  }

  // Where stem and suture are, and a bar as long as so many millimetres
  function named(rows) {
    const px_per_mm = zoom / reach * canvas.clientHeight / 2;
    const spots = [[middle[0], middle[1], high[2] + 2], [high[0] + 2, middle[1], middle[2]]];
    ends.forEach((end, k) => {
      const [x, y, near] = rows.map((row) => row.reduce((sum, each, j) => sum + each * (spots[k][j] - middle[j]), 0));
      end.style.left = `${canvas.clientWidth / 2 + x * px_per_mm}px`;
      end.style.top = `${canvas.clientHeight / 2 - y * px_per_mm}px`;
      end.classList.toggle("behind", near < -3);
    });
    const mm = BARS_MM.find((each) => each * px_per_mm >= 50) || 100;
    scale.style.width = `${mm * px_per_mm}px`;
    scale.textContent = `${mm} mm`;
  }

  function turned(right, up) {
    yaw -= right;
    pitch = Math.max(-1.57, Math.min(1.57, pitch + up));
    draw();
  }
  document.addEventListener("click", (event) => {
    const button = event.target.closest("button.turn");
    if (!button) return;
    dialog.querySelector("h2").textContent = button.dataset.name;
    dialog.showModal();
    canvas.focus();
    lacking.hidden = gl !== null || begun();
    if (!lacking.hidden) return;
    [yaw, pitch, zoom] = [0.6, 0.35, 1];
    scene = sceneOf(button.dataset.scene);
    ends.forEach((end) => { end.hidden = !scene.named; });
    for (const option of choice.options) option.hidden = option.disabled = option.value === "photo" || option.value !== "" && !(scene.map && scene.map.name === option.value);
    choice.closest("label").hidden = !scene.photo && !scene.map;
    choice.value = "";
    cut.value = 0;
    current = button;
    load();
    draw();
    // until this fruit's photo is decoded, and where it cannot be, the skin has the pad contacts
    if (scene.photo) createImageBitmap(scene.jpeg).then((picture) => {
      if (current !== button) return;
      gl.uniform3fv(uniforms.eye, scene.photo.middle);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
      const option = choice.querySelector("[value=photo]");
      option.hidden = option.disabled = false;
      if (choice.value) return;
      choice.value = "photo";
      load();
      draw();
    }, () => {});
  });
  choice.addEventListener("change", () => {
    load();
    draw();
  });
  cut.addEventListener("input", draw);
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons) turned(event.movementX / 150, event.movementY / 150);
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom = Math.max(0.5, Math.min(6, zoom * Math.exp(-event.deltaY / 800)));
    draw();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
    if (way) turned(...way);
    else if (event.key === "+" || event.key === "-") zoom = Math.max(0.5, Math.min(6, zoom * (event.key === "+" ? 1.15 : 0.87)));
    else return;
    event.preventDefault();
    draw();
  });
  dialog.querySelector("button").addEventListener("click", () => dialog.close());
})();
