"use strict";
/* The picture of the page; view.js moves it.
 * The scene is drawn as core/splat/raster.c does it, in four steps:
 *   sort     nearest first, in a worker                                   when the camera changes
 *   project  one texel per splat: where it is, its shape, its radiance    when one of these changed
 *   blend    premultiplied radiance                                       after that
 *   tone     radiance to display values at an exposure                    always
 * Radiance in the picture is divided by info.unit, a power of two, so that the brightest fits into
 * half floats. Rows of pictures go from top to bottom, in textures too. */

const byId = (id) => document.getElementById(id);
const info = JSON.parse(byId("info").textContent);
const BATCH = 4096; // splats of one instance: many small instances are slow
const HALF_MAX = 65504;
const LOG2_ALPHA_MIN = -7.99435344, ALPHA_MAX = 0.999, STOP = 1e-4; // core/kernels/kernels.h
const TURBO = [ // red, green, blue of the powers 0..5: core/photo/falsecolour.c
  [0.13572138, 0.0914026, 0.1066733], [4.6153926, 2.19418839, 12.64194608],
  [-42.66032258, 4.84296658, -60.58204836], [132.13108234, -14.18503333, 110.36276771],
  [-152.94239396, 4.27729857, -89.90310912], [59.28637943, 2.82956604, 27.34824973]];
const FALSE_STOPS = 8;
const CLIPPED = 0.99, DARK = 0.01; // display values of the brightest colour
const NO_BOX = [-1e9, -1e9, -1e9, 1e9, 1e9, 1e9];
const CURVE_CELLS = 2048;

function tell(sentence) { // "": nothing to tell
  byId("message").textContent = sentence;
  byId("message").hidden = !sentence;
}

/* There will be no picture, and nothing to control. */
function fail(sentence) {
  tell(sentence);
  document.body.className = "";
  document.querySelector("footer").hidden = true;
}

/* ---- GPU ---- */

const coefficients = (info.degree + 1) ** 2;
const shTexels = Math.ceil(3 * (coefficients - 1) / 8); // 8 half floats each

const COMMON = (width) => `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;
#define WIDTH ${width}
#define AT(i) ivec2((i) & ${width - 1}, (i) >> ${Math.log2(width)})
`;

/* sh_body.h */
const BASIS = [[], [
  "float b1 = -0.48860251190292 * d.y;",
  "float b2 = 0.48860251190292 * d.z;",
  "float b3 = -0.48860251190292 * d.x;"], [
  "float zz = d.z * d.z, c1 = d.x * d.x - d.y * d.y, s1 = 2.0 * d.x * d.y;",
  "float b4 = 0.5462742152960395 * s1;",
  "float b5 = -1.092548430592079 * d.z * d.y;",
  "float b6 = 0.9461746957575601 * zz - 0.3153915652525201;",
  "float b7 = -1.092548430592079 * d.z * d.x;",
  "float b8 = 0.5462742152960395 * c1;"], [
  "float c2 = d.x * c1 - d.y * s1, s2 = d.x * s1 + d.y * c1;",
  "float p11 = -2.285228997322329 * zz + 0.4570457994644658;",
  "float b9 = -0.5900435899266435 * s2;",
  "float b10 = 1.445305721320277 * d.z * s1;",
  "float b11 = p11 * d.y;",
  "float b12 = d.z * (1.865881662950577 * zz - 1.119528997770346);",
  "float b13 = p11 * d.x;",
  "float b14 = 1.445305721320277 * d.z * c1;",
  "float b15 = -0.5900435899266435 * c2;"], [
  "float c3 = d.x * c2 - d.y * s2, s3 = d.x * s2 + d.y * c2;",
  "float p18 = 3.31161143515146 * zz - 0.47308734787878;",
  "float p19 = d.z * (-4.683325804901025 * zz + 2.007139630671868);",
  "float b16 = 0.6258357354491763 * s3;",
  "float b17 = -1.770130769779931 * d.z * s2;",
  "float b18 = p18 * s1;",
  "float b19 = p19 * d.y;",
  "float b20 = 1.984313483298443 * d.z * b12 - 1.006230589874905 * b6;",
  "float b21 = p19 * d.x;",
  "float b22 = p18 * c1;",
  "float b23 = -1.770130769779931 * d.z * c2;",
  "float b24 = 0.6258357354491763 * c3;"]];

/* Adds the bands above 0 to `light`; half float number j is coefficient j / 3 + 1, colour j % 3. */
function harmonicsCode() {
  const lines = BASIS.slice(0, info.degree + 1).flat();
  for (let j = 0; j < 3 * (coefficients - 1); j++) {
    if (j % 8 === 0) {
      lines.push(`w = texelFetch(harmonics, AT(${shTexels} * i + ${j / 8}), 0);`);
      for (let k = 0; k < 4; k++) lines.push(`h${k} = unpackHalf2x16(w[${k}]);`);
    }
    const half = `h${(j % 8) >> 1}.${"xy"[j % 2]}`;
    lines.push(`light.${"xyz"[j % 3]} += b${Math.floor(j / 3) + 1} * ${half};`);
  }
  return lines.join("\n  ");
}

const FULL = `
void main() {
  gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}`;

/* splat_body.h, project_lanes; the layout of a splat is told in viewer.c. */
const PROJECT = `
uniform usampler2D order, splats, harmonics;
uniform mat3 R;
uniform vec3 T, centre;
uniform vec4 K, lim;
uniform vec2 size;
uniform int seen;
uniform float guesses;
uniform vec3 boxLo, boxHi;
layout(location = 0) out vec4 place;
layout(location = 1) out vec4 shape;
layout(location = 2) out vec4 colour;

vec2 halves(uint w) { return vec2(w & 0xffffu, w >> 16); }

mat3 rotation(uint a, uint b, uint c) {
  vec3 v = (vec3(a & 0x7fffu, b & 0x7fffu, c & 0x7fffu) / 16383.0 - 1.0) * 0.70710678118654752;
  float big = sqrt(max(0.0, 1.0 - dot(v, v)));
  uint k = a >> 15 | b >> 15 << 1;
  vec4 q = k == 0u ? vec4(big, v) : k == 1u ? vec4(v.x, big, v.yz) :
    k == 2u ? vec4(v.xy, big, v.z) : vec4(v, big);
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
              2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
              2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

/* First and last pixel of an axis: gsplat's circle chooses tiles, the 1/255 contour pixels. */
vec2 range(float at, float radius, float extent, float n) {
  float t0 = max(floor((at - radius) / 16.0), 0.0);
  float t1 = min(ceil((at + radius) / 16.0), ceil(n / 16.0));
  float lo = max(ceil(at - extent - 0.5), t0 * 16.0);
  float hi = min(floor(at + extent - 0.5), min(t1 * 16.0, n) - 1.0);
  return vec2(clamp(lo, 0.0, n), clamp(hi, -1.0, n - 1.0));
}

vec3 radiance(int i, vec3 dc, vec3 to) {
  vec3 light = dc;
  vec3 d = to / sqrt(max(dot(to, to), 1e-36));
  uvec4 w;
  vec2 h0, h1, h2, h3;
  ${harmonicsCode()}
  return exp(clamp(light, -60.0, 60.0));
}

void main() {
  int slot = int(gl_FragCoord.y) * WIDTH + int(gl_FragCoord.x);
  place = vec4(0.0, 0.0, -1.0, 0.0);
  shape = colour = vec4(0.0);
  if (slot >= seen) return;
  int i = int(texelFetch(order, AT(slot), 0).x);
  uvec4 a = texelFetch(splats, AT(2 * i), 0), b = texelFetch(splats, AT(2 * i + 1), 0);
  float kept = (b.z & 0x8000u) != 0u ? guesses : 1.0; // of its opacity
  if (kept == 0.0) return;
  vec3 m = uintBitsToFloat(a.xyz), p = R * m + T;
  if (!(p.z >= 1e-10 && p.z <= 1e10)) return;
  if (any(lessThan(m, boxLo)) || any(greaterThan(m, boxHi))) return;
  vec3 s = exp(vec3(halves(a.w), b.x & 0xffffu) * SCALE_STEP + SCALE_LO);
  float logit = float(b.x >> 16) * LOGIT_STEP + LOGIT_LO;
  mat3 V = transpose(R * rotation(b.y & 0xffffu, b.y >> 16, b.z & 0xffffu));
  float rz = 1.0 / p.z;
  vec2 j = K.xy * rz, c = clamp(p.xy * rz, -lim.xz, lim.yw);
  vec3 n0 = (j.x * V[0] - j.x * c.x * V[2]) * s, n1 = (j.y * V[1] - j.y * c.y * V[2]) * s;
  float nn0 = dot(n0, n0), nn1 = dot(n1, n1), xy = dot(n0, n1);
  vec3 x = cross(n0, n1);
  float det = dot(x, x) + 0.3 * (nn0 + nn1) + 0.09, xx = nn0 + 0.3, yy = nn1 + 0.3;
  if (!(xx + yy < 1e18 && det > 0.0 && 9.0 * dot(V[2] * s, V[2] * s) <= p.z * p.z)) return;
  float top = log2(kept) - log2(1.0 + exp(-logit));
  float reach = (top - (${LOG2_ALPHA_MIN})) * 1.38629436;
  if (reach < 0.0) return;
  float half_ = 0.5 * (xx - yy);
  float r = ceil(3.0 * sqrt(0.5 * (xx + yy) + sqrt(max(half_ * half_ + xy * xy, 0.01))));
  vec2 at = K.xy * (p.xy * rz) + K.zw;
  vec2 bx = range(at.x, r, sqrt(reach * xx) * 1.001 + 0.01, size.x);
  vec2 by = range(at.y, r, sqrt(reach * yy) * 1.001 + 0.01, size.y);
  if (!(bx.x <= bx.y && by.x <= by.y && all(lessThan(abs(at), vec2(1e9))))) return;
  place = vec4(at, bx.x * 4096.0 + bx.y, by.x * 4096.0 + by.y);
  shape = vec4(0.72134752 * yy / det, xy / yy, 0.72134752 / yy, top);
  vec3 dc = vec3(b.z >> 16, halves(b.w)) * LIGHT_STEP + LIGHT_LO;
  colour = vec4(min(radiance(i, dc, m - centre) / UNIT, 65504.0), p.z);
}`;

/* A quad of four corners for each splat; the pixels of its box are exactly those of raster.c. */
const QUADS = `
uniform sampler2D place, shape, colour;
uniform vec2 size;
uniform int seen;
flat out vec4 s;
flat out vec2 at;
flat out vec3 light;
void main() {
  int slot = seen - 1 - (gl_InstanceID * ${BATCH} + (gl_VertexID >> 2));
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  if (slot < 0) return;
  vec4 p = texelFetch(place, AT(slot), 0);
  if (p.z < 0.0) return;
  vec2 lo = floor(p.zw / 4096.0), hi = p.zw - lo * 4096.0 + 1.0;
  vec2 corner = vec2((gl_VertexID & 1) == 0 ? lo.x : hi.x, (gl_VertexID & 2) == 0 ? lo.y : hi.y);
  gl_Position = vec4(corner / size * 2.0 - 1.0, 0.0, 1.0);
  s = texelFetch(shape, AT(slot), 0);
  at = p.xy;
  light = texelFetch(colour, AT(slot), 0).rgb;
}`;

const BLEND = `
flat in vec4 s;
flat in vec2 at;
flat in vec3 light;
out vec4 pixel;
void main() {
  vec2 d = at - gl_FragCoord.xy;
  float x = d.x - s.y * d.y, power = s.w - s.x * x * x - s.z * d.y * d.y;
  if (power < ${LOG2_ALPHA_MIN}) discard;
  float alpha = min(exp2(power), ${ALPHA_MAX});
  pixel = vec4(light * alpha, alpha);
}`;

/* Curves: logits at even steps from curveLo on, linear between them and beyond, as tonemap.c.
 * frame: x, y of its corners; outside: how much of what is outside is shown. Where splats hardly
 * cover it is hatched: nobody saw that, and the background of a scene is the mean of what was. */
const TONE = `
uniform sampler2D picture, curves, photo;
uniform ivec2 size;
uniform vec2 span;
uniform vec4 box, frame;
uniform float shift, curveLo, curveScale, clip, hatch, outside;
uniform int mode, rough, unseen;
out vec4 pixel;

float tone(float L, int c) {
  float f = (log2(L + 1e-6) + shift - curveLo) * curveScale;
  int i = int(clamp(f, 0.0, ${CURVE_CELLS - 2}.0));
  float a = texelFetch(curves, ivec2(i, 0), 0)[c], b = texelFetch(curves, ivec2(i + 1, 0), 0)[c];
  return 1.0 / (1.0 + exp(-mix(a, b, f - float(i))));
}

vec3 srgb(vec3 v) {
  return mix(1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055, 12.92 * v, lessThanEqual(v, vec3(0.0031308)));
}

vec3 turbo(float stops) {
  float x = (stops - span.x + span.y) / (2.0 * span.y);
  if (!(x >= 0.0)) return vec3(0.0);
  if (x > 1.0) return vec3(1.0);
  vec3 v = vec3(${TURBO[5]});
  ${[4, 3, 2, 1, 0].map((k) => `v = v * x + vec3(${TURBO[k]});`).join("\n  ")}
  return v;
}

void main() {
  vec2 at = vec2(gl_FragCoord.x, float(size.y) - gl_FragCoord.y);
  vec4 P = rough == 1 ? texture(picture, at / vec2(size)) : texelFetch(picture, ivec2(at), 0);
  vec3 L = P.rgb * UNIT;
  vec3 shown = vec3(tone(L.r, 0), tone(L.g, 1), tone(L.b, 2));
  if (mode == 1) L = srgb(min(L * exp2(shift + SRGB_EV), 1.0));
  else if (mode == 2) L = turbo(log2(dot(L, vec3(0.2126, 0.7152, 0.0722))) + shift + MIDDLE);
  else L = shown;
  vec2 p = (at - box.xy) / box.zw; // of the photograph
  if (box.z > 0.0 && p == clamp(p, 0.0, 1.0)) L = abs(shown - texture(photo, p).rgb) * 4.0;
  float top = max(shown.r, max(shown.g, shown.b));
  vec2 cell = fract(at / max(clip, 1.0)) - 0.5; // stripes: clipped, dots: dark
  if (clip > 0.0 && top > ${CLIPPED}) L = vec3(1.0, 0.4, 0.2) * step(fract(cell.x + cell.y), 0.5);
  if (clip > 0.0 && top < ${DARK}) L = vec3(0.2, 0.6, 1.0) * step(dot(cell, cell), 0.07);
  float known = clamp(2.0 * P.a - 0.5, 0.0, 1.0);
  if (any(lessThan(at, frame.xy)) || any(greaterThan(at, frame.zw))) known *= outside;
  vec3 back = vec3(0.078, 0.082, 0.09) * (fract((at.x + at.y) / hatch) < 0.2 ? 1.8 : 1.0);
  pixel = vec4(unseen == 1 ? L : mix(back, L, known), 1.0);
}`;

const canvas = byId("view");
let gl, gpu;

/* The driver does it meanwhile, until somebody asks: link(). */
function compile(vertex, fragment) {
  const program = gl.createProgram();
  const texts = [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]];
  const shaders = texts.map(([kind, text]) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    return shader;
  });
  gl.linkProgram(program);
  return { program, shaders, at: {} };
}

function link({ program, shaders, at }) {
  if (!gl.getProgramParameter(program, gl.LINK_STATUS))
    throw new Error("the graphics driver refuses a program: " +
      [gl.getProgramInfoLog(program), ...shaders.map((s) => gl.getShaderInfoLog(s))].join(" "));
  for (let i = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) - 1; i >= 0; i--) {
    const name = gl.getActiveUniform(program, i).name;
    at[name] = gl.getUniformLocation(program, name);
  }
}

function texture(format, width, height) {
  const t = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, t);
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
  for (const [key, value] of [["MIN_FILTER", "NEAREST"], ["MAG_FILTER", "NEAREST"],
    ["WRAP_S", "CLAMP_TO_EDGE"], ["WRAP_T", "CLAMP_TO_EDGE"]])
    gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${key}`], gl[value]);
  return t;
}

/* Texels of one or four words each, from number `at` of the table on, in rows of its width; the
 * first and the last row may be short. */
function fill(t, data, at, words) {
  const end = at + data.length / words, format = words === 1 ? gl.RED_INTEGER : gl.RGBA_INTEGER;
  gl.bindTexture(gl.TEXTURE_2D, t);
  for (let from = 0, w, rows; at < end; at += w * rows, from += w * rows * words) {
    const x = at % gpu.width, y = Math.floor(at / gpu.width);
    w = Math.min(end - at, gpu.width - x);
    rows = x ? 1 : Math.max(1, Math.floor((end - at) / gpu.width));
    gl.texSubImage2D(gl.TEXTURE_2D, 0, x, y, w, rows, format, gl.UNSIGNED_INT, data, from);
  }
}

function table(format, texels) {
  const rows = Math.max(1, Math.ceil(texels / gpu.width));
  if (rows > gpu.limit)
    throw new Error(`the scene has ${info.n} splats, more than this graphics driver can hold`);
  return texture(format, gpu.width, rows);
}

function target(textures) {
  const f = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, f);
  textures.forEach((t, k) => gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + k,
    gl.TEXTURE_2D, t, 0));
  gl.drawBuffers(textures.map((t, k) => gl.COLOR_ATTACHMENT0 + k));
  if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE)
    throw new Error("this graphics driver cannot draw into floating-point pictures");
  return f;
}

/* Logits of the scene's curve, exactly as long as no knot lies within a cell. */
function curveTable() {
  const p = info.tone, knots = [];
  for (let c = 0; c < 3; c++)
    for (let k = 0; k < 64; k++)
      if (p[193 * c + k] !== 0) knots.push(-p[193 * c + 64 + k] / p[193 * c + k]);
  const near = knots.filter((x) => Math.abs(x) < 64);
  const lo = Math.min(0, ...near) - 0.5, hi = Math.max(0, ...near) + 0.5;
  const data = new Float32Array(4 * CURVE_CELLS);
  for (let i = 0; i < CURVE_CELLS; i++)
    for (let c = 0; c < 3; c++) {
      const x = lo + (hi - lo) * i / (CURVE_CELLS - 1), o = 193 * c;
      let sum = p[o + 192];
      for (let k = 0; k < 64; k++)
        sum += p[o + 128 + k] * Math.max(0, p[o + k] * x + p[o + 64 + k]);
      data[4 * i + c] = sum;
    }
  return { lo, scale: (CURVE_CELLS - 1) / (hi - lo), data };
}

function quadIndices() {
  const index = new Uint16Array(6 * BATCH);
  for (let i = 0; i < BATCH; i++) index.set([0, 1, 2, 2, 1, 3].map((k) => 4 * i + k), 6 * i);
  return index;
}

/* ---- the scene: pagesplats.h, pagepack.h ---- */

/* Base64, a piece at a time. */
function bytesOf(text, size) {
  const out = new Uint8Array(size), step = 1 << 20;
  let to = 0;
  if (text.length !== 4 * Math.ceil(size / 3))
    throw new Error("the page is cut off: " +
      `${text.length} of ${4 * Math.ceil(size / 3)} characters of its scene`);
  if (out.setFromBase64) out.setFromBase64(text); // newer browsers: five times as fast
  else for (let from = 0; from < text.length; from += step) {
    const s = atob(text.slice(from, from + step));
    for (let i = 0; i < s.length; i++) out[to++] = s.charCodeAt(i);
  }
  return out;
}

/* The n splats in the page's element. */
function decode(id, n) {
  const text = byId(id) ? byId(id).textContent : "", { packed } = info;
  if (!packed) return bytesOf(text, n * (32 + 16 * shTexels)).buffer;
  const bytes = bytesOf(text, packed.bytes[id === "rest" ? 1 : 0]);
  return unpack(inflate(bytes, n * (24 + 6 * coefficients)), n);
}

const number = (v) => { // a GLSL constant
  const text = String(v);
  return /[.e]/.test(text) ? text : text + ".0";
};

/* All but the scene, which is still being read. */
function openGpu() {
  gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, stencil: false,
    powerPreference: "high-performance" });
  if (!gl) throw new Error("this browser does not offer WebGL 2, which the picture needs");
  if (!gl.getExtension("EXT_color_buffer_float"))
    throw new Error("this graphics driver cannot draw into floating-point pictures " +
      "(EXT_color_buffer_float), which radiance needs");
  const limit = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  gpu = { limit, width: limit < 4096 ? 2048 : 4096, pw: 0, ph: 0, format: 0,
    still: gl.getExtension("EXT_float_blend") ? gl.RGBA32F : gl.RGBA16F };
  const names = { UNIT: info.unit, SRGB_EV: info.srgb_ev, MIDDLE: info.middle,
    SCALE_LO: info.scale[0], SCALE_STEP: info.scale[1], LOGIT_LO: info.logit[0],
    LOGIT_STEP: info.logit[1], LIGHT_LO: info.light[0], LIGHT_STEP: info.light[1] };
  const head = COMMON(gpu.width) +
    Object.entries(names).map(([k, v]) => `#define ${k} (${number(v)})\n`).join("");
  gpu.project = compile(head + FULL, head + PROJECT);
  gpu.blend = compile(head + QUADS, head + BLEND);
  gpu.tone = compile(head + FULL, head + TONE);
  for (const program of [gpu.project, gpu.blend, gpu.tone]) link(program);
  const n = info.n;
  gpu.splats = table(gl.RGBA32UI, 2 * n);
  gpu.harmonics = table(gl.RGBA32UI, shTexels * n);
  gpu.order = table(gl.R32UI, n);
  gpu.maps = [0, 1, 2].map(() => table(gl.RGBA32F, n));
  gpu.projected = target(gpu.maps);
  gpu.curve = curveTable();
  gpu.curves = texture(gl.RGBA32F, CURVE_CELLS, 1);
  gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, CURVE_CELLS, 1, gl.RGBA, gl.FLOAT, gpu.curve.data);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, quadIndices(), gl.STATIC_DRAW);
  gl.disable(gl.DITHER);
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
}

/* n splats from number `at` on. */
function fillGpu(scene, at, n) {
  const words = new Uint32Array(scene);
  fill(gpu.splats, words.subarray(0, 8 * n), 2 * at, 4);
  fill(gpu.harmonics, words.subarray(8 * n), shTexels * at, 4);
  if (gl.getError() === gl.OUT_OF_MEMORY)
    throw new Error(`the scene has ${info.n} splats, ` +
      "too many for the memory of this graphics driver");
}

function use(p, textures) {
  gl.useProgram(p.program);
  Object.entries(textures).forEach(([name, t], k) => {
    gl.activeTexture(gl.TEXTURE0 + k);
    gl.bindTexture(gl.TEXTURE_2D, t);
    gl.uniform1i(p.at[name], k);
  });
}

/* ---- sorting ---- */

/* Runs in the worker: splats before the camera by depth, nearest first, ties by number, as
 * raster.c; least significant digit first. */
function sorter(n) {
  const mu = new Float32Array(3 * n), keys = [new Uint32Array(n), new Uint32Array(n)];
  const orders = [new Uint32Array(n), new Uint32Array(n)];
  const DIGIT = 11, DIGITS = 3, SIZE = 1 << DIGIT;
  function sort([a, b, c, d], upTo) {
    const depth = new Float32Array(keys[0].buffer);
    let seen = 0;
    for (let i = 0; i < upTo; i++) {
      const z = a * mu[3 * i] + b * mu[3 * i + 1] + c * mu[3 * i + 2] + d;
      if (z >= 1e-10) {
        depth[seen] = z;
        orders[0][seen++] = i;
      }
    }
    for (let p = 0; p < DIGITS; p++) {
      const count = new Uint32Array(SIZE), shift = DIGIT * p;
      const key = keys[p & 1], order = orders[p & 1], key2 = keys[~p & 1], order2 = orders[~p & 1];
      for (let i = 0; i < seen; i++) count[key[i] >>> shift & SIZE - 1]++;
      for (let i = 0, total = 0; i < SIZE; i++) total += count[i], count[i] = total - count[i];
      for (let i = 0; i < seen; i++) {
        const to = count[key[i] >>> shift & SIZE - 1]++;
        key2[to] = key[i];
        order2[to] = order[i];
      }
    }
    return seen;
  }
  onmessage = ({ data }) => {
    if (data.mu) return mu.set(data.mu, 3 * data.at);
    const seen = sort(data.row, data.upTo), order = orders[1].slice(0, seen);
    postMessage({ ...data, seen, order }, [order.buffer]);
  };
}

/* sent: splats whose places the worker has; loaded: those that the GPU has, too; row: of the depths
 * that they are sorted by; upTo: how many of them. */
const sorting = { worker: null, sent: 0, loaded: 0, busy: false, row: null, upTo: 0, seen: -1 };

function sendPlaces(scene, at, n) {
  const all = new Float32Array(scene, 0, 8 * n), mu = new Float32Array(3 * n);
  for (let i = 0; i < n; i++)
    for (let k = 0; k < 3; k++) mu[3 * i + k] = all[8 * i + k];
  sorting.worker.postMessage({ mu, at }, [mu.buffer]);
  sorting.sent = at + n;
}

function openSorter() {
  const text = `(${sorter})(${info.n})`;
  const url = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
  sorting.worker = new Worker(url);
  sorting.worker.onerror = ({ message }) =>
    fail(`this browser cannot sort the splats in a worker: ${message || "it refuses"}`);
  sorting.worker.onmessage = ({ data }) => {
    sorting.busy = false;
    if (gl.isContextLost()) return;
    const { row, upTo, seen } = data;
    Object.assign(sorting, { row, upTo, seen });
    fill(gpu.order, data.order, 0, 1);
    invalidate(true);
    requestSort();
  };
}

const same = (a, b) => a && b && a.every((v, k) => v === b[k]);

function requestSort() {
  const { R, t } = state.cam, row = [R[6], R[7], R[8], t[2]];
  const upTo = sorting.loaded;
  if (sorting.busy || (sorting.upTo === upTo && same(sorting.row, row))) return;
  sorting.busy = true;
  sorting.worker.postMessage({ row, upTo });
}

/* ---- cameras: { w, h, fx, fy, cx, cy, R, t } as struct camera, R row by row ---- */

function rotation([w, x, y, z]) {
  return [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
}

function cameraOf(v) {
  const [fx, fy, cx, cy] = v.k;
  const [w, h] = v.px || [info.size, info.size];
  return { w, h, fx, fy, cx, cy, R: rotation(v.q), t: v.t.slice() };
}

const centreOf = ({ R, t }) =>
  [0, 1, 2].map((k) => -(R[k] * t[0] + R[3 + k] * t[1] + R[6 + k] * t[2]));

function place(cam, centre) {
  cam.t = [0, 3, 6].map((r) =>
    -(cam.R[r] * centre[0] + cam.R[r + 1] * centre[1] + cam.R[r + 2] * centre[2]));
}

/* The camera's picture, as large as it fits, in the middle of w x h px. */
function fit(cam, w, h) {
  const s = Math.min(w / cam.w, h / cam.h), left = (w - s * cam.w) / 2, top = (h - s * cam.h) / 2;
  return { w, h, s, left, top, fx: cam.fx * s, fy: cam.fy * s, cx: cam.cx * s + left,
    cy: cam.cy * s + top };
}

/* ---- drawing ---- */

/* at, last: of the views; -1: none. focus: distance of what the camera turns around. guesses: how
 * much of them is drawn; outside: how much of what is outside the camera's picture; unseen: whether
 * what no photograph shows is drawn; box: which splats are drawn, from x, y, z to x, y, z. moving:
 * the picture may be rough; coarse: then, screen pixels for one of the picture; moved: when, ms.
 * middle, reach: stops of the false colours; clip: what is clipped or dark is marked. */
const state = { cam: null, at: -1, last: 0, focus: 1, ev: 0, tone: 0, wipe: false, split: 50,
  proven: false, guesses: 1, outside: 0, unseen: false, box: NO_BOX,
  moving: true, coarse: 2, moved: -1e9, probe: null, middle: 0, reach: FALSE_STOPS, clip: false };
let scheduled = false, stale = true, firstPicture = 0;

function invalidate(geometry) {
  stale = stale || geometry;
  if (!scheduled) requestAnimationFrame(frame);
  scheduled = true;
}

function resize() {
  const { clientWidth, clientHeight } = canvas;
  const most = Math.min(4080, gpu.limit);
  const ratio = Math.min(devicePixelRatio || 1, most / Math.max(clientWidth, clientHeight));
  const w = Math.max(1, Math.round(clientWidth * ratio));
  const h = Math.max(1, Math.round(clientHeight * ratio));
  if (w === canvas.width && h === canvas.height) return;
  canvas.width = w;
  canvas.height = h;
  stale = true;
  if (firstPicture) state.moved = performance.now(); // rough while a window is drawn larger
}

/* Half floats while the camera moves; at rest floats where they can be blended. */
function openPicture(w, h) {
  const format = state.moving ? gl.RGBA16F : gpu.still;
  if (gpu.pw === w && gpu.ph === h && gpu.format === format) return;
  if (gpu.picture) {
    gl.deleteTexture(gpu.picture);
    gl.deleteFramebuffer(gpu.blended);
  }
  gpu.picture = texture(format, w, h);
  for (const key of ["MIN", "MAG"]) // of half floats alone; floats are never enlarged
    gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${key}_FILTER`],
      format === gl.RGBA16F ? gl.LINEAR : gl.NEAREST);
  gpu.blended = target([gpu.picture]);
  Object.assign(gpu, { pw: w, ph: h, format });
}

const backdrop = () => info.background.map((x) => Math.min(x / info.unit, HALF_MAX));

function project(v) {
  const p = gpu.project, { R, t } = state.cam;
  gpu.listed = null;
  const mx = 0.15 * v.w / v.fx, my = 0.15 * v.h / v.fy;
  gl.bindFramebuffer(gl.FRAMEBUFFER, gpu.projected);
  gl.viewport(0, 0, gpu.width, Math.ceil(sorting.seen / gpu.width));
  use(p, { order: gpu.order, splats: gpu.splats, harmonics: gpu.harmonics });
  gl.uniformMatrix3fv(p.at.R, true, R);
  gl.uniform3fv(p.at.T, t);
  gl.uniform3fv(p.at.centre, centreOf(state.cam));
  gl.uniform4f(p.at.K, v.fx, v.fy, v.cx, v.cy);
  gl.uniform4f(p.at.lim, v.cx / v.fx + mx, (v.w - v.cx) / v.fx + mx,
    v.cy / v.fy + my, (v.h - v.cy) / v.fy + my);
  gl.uniform2f(p.at.size, v.w, v.h);
  gl.uniform1i(p.at.seen, sorting.seen);
  gl.uniform1f(p.at.guesses, state.proven ? 0 : state.guesses);
  gl.uniform3fv(p.at.boxLo, state.box.slice(0, 3));
  gl.uniform3fv(p.at.boxHi, state.box.slice(3));
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}

/* Farthest first over the background: errors of half floats fade with what is drawn over them.
 * raster.c goes the other way and ends before the splat that less than 1e-4 would pass, which may
 * weigh up to 0.1 (alpha 0.999 behind 0.9). Blending cannot compare what it reads, so this picture
 * shows what is behind such places; exact() does not. */
function blend(v) {
  const p = gpu.blend, [r, g, b] = backdrop();
  gl.bindFramebuffer(gl.FRAMEBUFFER, gpu.blended);
  gl.viewport(0, 0, v.w, v.h);
  gl.clearColor(r, g, b, 0);
  gl.clear(gl.COLOR_BUFFER_BIT);
  if (sorting.seen < 1) return;
  use(p, { place: gpu.maps[0], shape: gpu.maps[1], colour: gpu.maps[2] });
  gl.uniform2f(p.at.size, v.w, v.h);
  gl.uniform1i(p.at.seen, sorting.seen);
  gl.enable(gl.BLEND);
  gl.drawElementsInstanced(gl.TRIANGLES, 6 * BATCH, gl.UNSIGNED_SHORT, 0,
    Math.ceil(sorting.seen / BATCH));
  gl.disable(gl.BLEND);
}

function tone() {
  const p = gpu.tone, own = photograph(), photo = photoTexture(own);
  const ratio = canvas.width / canvas.clientWidth || 1;
  const { left, top, s } = fit(state.cam, canvas.width, canvas.height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.viewport(0, 0, canvas.width, canvas.height);
  use(p, { picture: gpu.picture, curves: gpu.curves, photo: photo || gpu.curves });
  gl.uniform4f(p.at.box, left, top, photo ? s * state.cam.w : 0, s * state.cam.h);
  gl.uniform2f(p.at.span, state.middle, state.reach);
  gl.uniform1f(p.at.clip, state.clip ? 8 * ratio : 0);
  gl.uniform2i(p.at.size, canvas.width, canvas.height);
  gl.uniform1i(p.at.rough, gpu.format === gl.RGBA16F && gpu.pw < canvas.width);
  gl.uniform1f(p.at.shift, photo ? own.stops : state.ev); // differences need one exposure
  gl.uniform1f(p.at.curveLo, gpu.curve.lo);
  gl.uniform1f(p.at.curveScale, gpu.curve.scale);
  gl.uniform1i(p.at.mode, state.tone);
  gl.uniform1i(p.at.unseen, state.unseen);
  gl.uniform1f(p.at.hatch, 10 * canvas.width / canvas.clientWidth);
  const v = fit(state.cam, canvas.width, canvas.height);
  gl.uniform1f(p.at.outside, state.outside);
  gl.uniform4f(p.at.frame, v.left, v.top, v.w - v.left, v.h - v.top);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}

function draw() {
  if (stale && sorting.seen >= 0) {
    const shrink = state.moving ? state.coarse : 1;
    const w = Math.ceil(canvas.width / shrink), h = Math.ceil(canvas.height / shrink);
    const v = fit(state.cam, w, h);
    openPicture(w, h);
    if (sorting.seen) project(v);
    blend(v);
    gpu.pictures = (gpu.pictures || 0) + 1;
    stale = false;
  }
  if (gpu.picture) tone();
}

function frame(now) {
  scheduled = false;
  if (gl.isContextLost()) return;
  resize();
  choosePace(now);
  draw();
  layPhoto();
  showProbe();
  showLight();
  if (!firstPicture && sorting.seen >= 0) {
    radiance(0, 0, 1, 1); // waits for the picture
    firstPicture = performance.now();
    state.coarse = 1;
    showFacts();
    requestAnimationFrame(() => { // the picture is seen, then the controls, then all of it
      document.body.className = "";
      invalidate(false);
      setTimeout(loadRest);
    });
  }
}

/* Drivers finish a program when it is first used: for a splat behind the camera. */
function warmUp() {
  state.cam = { w: 1, h: 1, fx: 1, fy: 1, cx: 0, cy: 0, R: [1, 0, 0, 0, 1, 0, 0, 0, 1],
    t: [0, 0, -1] };
  sorting.seen = 1;
  resize();
  draw();
  sorting.seen = -1;
  stale = true;
}

/* The first picture, and those while the camera moves, have fewer pixels where they come too
 * slowly; all of them at rest. */
const pace = { last: 0, timer: 0 };
function choosePace(now) {
  const moves = now - state.moved < 200, ms = now - pace.last;
  pace.last = now;
  if (moves && state.moving) { // not the first one: pictures in a row
    if (ms > 70) state.coarse = Math.min(state.coarse * 1.5, 5);
    if (ms < 24) state.coarse = Math.max(state.coarse / 1.1, 1);
  }
  if (moves) {
    clearTimeout(pace.timer);
    pace.timer = setTimeout(() => invalidate(false), 250);
  }
  const moving = moves || !firstPicture;
  if (state.moving && !moving) stale = true;
  state.moving = moving;
}

/* The three texels of each sorted splat, as numbers. */
function listed() {
  const rows = Math.ceil(sorting.seen / gpu.width);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gpu.projected);
  return gpu.maps.map((t, k) => {
    const out = new Float32Array(4 * gpu.width * rows);
    gl.readBuffer(gl.COLOR_ATTACHMENT0 + k);
    gl.readPixels(0, 0, gpu.width, rows, gl.RGBA, gl.FLOAT, out);
    return out;
  });
}

/* What a pixel of the picture shows, nearest first, by the rules of raster.c: meet gets the texel
 * of each splat's radiance and depth, and its share of the pixel. Returns the background's. */
function through(x, y, meet) {
  gpu.listed = gpu.listed || listed();
  const [place, shape, colour] = gpu.listed;
  const misses = (range, v) => v < Math.floor(range / 4096) || v > range % 4096;
  let rest = 1;
  for (let o = 0; o < 4 * sorting.seen; o += 4) {
    if (place[o + 2] < 0 || misses(place[o + 2], x) || misses(place[o + 3], y)) continue;
    const dy = place[o + 1] - y - 0.5, dx = place[o] - x - 0.5 - shape[o + 1] * dy;
    const power = shape[o + 3] - shape[o] * dx * dx - shape[o + 2] * dy * dy;
    if (power < LOG2_ALPHA_MIN) continue;
    const alpha = Math.min(2 ** power, ALPHA_MAX), next = rest * (1 - alpha);
    if (next <= STOP) break;
    meet(colour.subarray(o, o + 4), rest * alpha);
    rest = next;
  }
  return rest;
}

/* Linear R, G, B of a pixel of the picture. */
function exact(x, y) {
  const sum = [0, 0, 0];
  const rest = through(x, y, (light, share) => {
    for (let k = 0; k < 3; k++) sum[k] += share * light[k];
  });
  return backdrop().map((v, k) => (sum[k] + rest * v) * info.unit);
}

/* Depth that half of a pixel's cover lies before, scene units; 0: it is hardly covered. */
function depthAt(x, y) {
  const met = [];
  const half = (1 - through(x, y, (light, share) => met.push([light[3], share]))) / 2;
  let sum = 0;
  return half < 0.125 ? 0 : met.find(([, share]) => (sum += share) >= half)[0];
}

/* Linear R, G, B, and coverage 0..1, of w x h pixels of the picture; of `most` of them, evenly. */
function radiance(x, y, w, h, most = w * h) {
  const shrink = Math.max(1, Math.sqrt(w * h / most));
  const [sw, sh] = [w, h].map((v) => Math.max(1, Math.floor(v / shrink)));
  const small = texture(gpu.format, sw, sh), frame = target([small]);
  const out = new Float32Array(4 * sw * sh);
  gl.bindFramebuffer(gl.READ_FRAMEBUFFER, gpu.blended);
  gl.blitFramebuffer(x, y, x + w, y + h, 0, 0, sw, sh, gl.COLOR_BUFFER_BIT, gl.NEAREST);
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  gl.readPixels(0, 0, sw, sh, gl.RGBA, gl.FLOAT, out);
  gl.deleteFramebuffer(frame);
  gl.deleteTexture(small);
  return out.map((v, k) => k % 4 === 3 ? v : v * info.unit);
}
