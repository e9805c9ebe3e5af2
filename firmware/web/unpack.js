"use strict";
/* The splats of the page, as pagepack.h describes them, become those of pagesplats.h. */

/* Huffman's code as a table by the next bits of the stream, first bit lowest: 16 symbol + its
 * length. */
function codeTable(lengths) {
  const next = new Uint16Array(17);
  let most = 1;
  for (const n of lengths) {
    if (n) next[n + 1]++;
    if (n > most) most = n;
  }
  for (let n = 1; n <= 16; n++) next[n] = next[n] + next[n - 1] << 1; // first code of each length
  const table = new Uint16Array(1 << most);
  lengths.forEach((n, symbol) => {
    if (!n) return;
    let at = 0;
    for (let k = 0, code = next[n]++; k < n; k++, code >>= 1) at = at << 1 | code & 1;
    for (; at < table.length; at += 1 << n) table[at] = symbol << 4 | n;
  });
  return table;
}

const LENGTH_ORDER = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];

/* Base and extra bits of each length (from 3 on, in fours) or distance (from 1 on, in twos). */
function extras(count, from, group) {
  const base = [], bits = [];
  for (let k = 0, next = from; k < count; k++) {
    base.push(next);
    bits.push(Math.max(0, Math.floor(k / group) - 1));
    next += 1 << bits[k];
  }
  return { base, bits };
}
const LENGTHS = extras(28, 3, 4), DISTANCES = extras(30, 1, 2);
LENGTHS.base.push(258);
LENGTHS.bits.push(0);

/* Bits of a stream, lowest first; after its end come zeros. */
function bitsOf(bytes, at) {
  return { bytes, at, word: 0, left: 0 };
}

function take(s, n) { // up to 16
  while (s.left < n) {
    s.word |= s.bytes[s.at++] << s.left;
    s.left += 8;
  }
  const v = s.word & (1 << n) - 1;
  s.word >>>= n;
  s.left -= n;
  return v;
}

function damaged(how) {
  throw new Error(`the page is damaged: ${how} in its scene`);
}

function takeSymbol(s, table) {
  while (s.left < 15) {
    s.word |= s.bytes[s.at++] << s.left;
    s.left += 8;
  }
  const entry = table[s.word & table.length - 1], n = entry & 15;
  if (n === 0) damaged("no such code");
  s.word >>>= n;
  s.left -= n;
  return entry >> 4;
}

/* Tables of literals and lengths, and of distances. */
function takeCodes(s, kind) {
  const lengths = [];
  if (kind === 1) {
    for (let k = 0; k < 288; k++) lengths.push(k < 144 ? 8 : k < 256 ? 9 : k < 280 ? 7 : 8);
    return [codeTable(lengths), codeTable(Array(30).fill(5))];
  }
  const literals = take(s, 5) + 257, distances = take(s, 5) + 1, used = take(s, 4) + 4;
  const short = Array(19).fill(0);
  for (let k = 0; k < used; k++) short[LENGTH_ORDER[k]] = take(s, 3);
  const table = codeTable(short);
  while (lengths.length < literals + distances) {
    const v = takeSymbol(s, table), last = lengths[lengths.length - 1];
    if (v < 16) lengths.push(v);
    else for (let n = v === 16 ? 3 + take(s, 2) : v === 17 ? 3 + take(s, 3) : 11 + take(s, 7);
      n > 0; n--) lengths.push(v === 16 ? last : 0);
  }
  return [codeTable(lengths.slice(0, literals)),
    codeTable(lengths.slice(literals, literals + distances))];
}

/* A block of codes; returns how far `out` is filled. */
function inflateBlock(s, out, to, [literals, distances]) {
  const bytes = s.bytes, mask = literals.length - 1;
  for (;;) {
    let at = s.at, word = s.word, left = s.left, entry;
    for (;;) { // most symbols are literals: they go fast
      while (left < 15) {
        word |= bytes[at++] << left;
        left += 8;
      }
      entry = literals[word & mask];
      if (entry >= 256 << 4) break;
      word >>>= entry & 15;
      left -= entry & 15;
      out[to++] = entry >> 4;
      if (to > out.length) damaged("too many bytes");
    }
    s.at = at;
    s.word = word;
    s.left = left;
    let v = takeSymbol(s, literals) - 257;
    if (v < 0) return to;
    const n = LENGTHS.base[v] + take(s, LENGTHS.bits[v]);
    v = takeSymbol(s, distances);
    let from = to - DISTANCES.base[v] - take(s, DISTANCES.bits[v]);
    for (const end = to + n; to < end;) out[to++] = out[from++];
  }
}

/* `size` bytes of a gzip stream: RFC 1951, 1952. Browsers unpack such streams too, but not while
 * others wait for them. */
function inflate(bytes, size) {
  const out = new Uint8Array(size), head = 10 + (bytes[3] & 16 && bytes.indexOf(0, 10) - 9);
  const s = bitsOf(bytes, head); // behind the comment
  let to = 0;
  for (let last = 0; !last;) {
    last = take(s, 1);
    const kind = take(s, 2);
    if (kind) {
      to = inflateBlock(s, out, to, takeCodes(s, kind));
    } else {
      take(s, s.left & 7);
      const n = take(s, 16);
      take(s, 16);
      for (let k = 0; k < n; k++) out[to++] = take(s, 8);
    }
    if (s.at > bytes.length) damaged("too few bytes");
  }
  if (to !== size) damaged(`${to} of ${size} bytes`);
  return out;
}

/* Half floats of the 65,536 numbers of a field, times `step`: 0, or not below 2^-14. */
function halvesOf(step) {
  const floats = new Float32Array(1 << 16).map((_, v) => unfold(v) * step);
  return Uint16Array.from(new Uint32Array(floats.buffer), (word) => {
    const rounded = word + 0x1000, exponent = (rounded >>> 23 & 255) - 112;
    return word >>> 16 & 0x8000 |
      (exponent < 1 ? 0 : exponent > 30 ? 0x7bff : exponent << 10 | rounded >>> 13 & 1023);
  });
}

const unfold = (v) => v >>> 1 ^ -(v & 1);

/* Fields of pagepack.h, of n splats, become the splats of pagesplats.h. */
function unpack(bytes, n) {
  const { packed } = info, out = new ArrayBuffer(n * (32 + 16 * shTexels));
  const floats = new Float32Array(out, 0, 8 * n), words = new Uint16Array(out);
  const halves = coefficients > 1 ? halvesOf(packed.sh) : null, at = packed.low.slice();
  const two = (from) => bytes[from] | bytes[from + n] << 8; // bytes of the number there
  for (let i = 0; i < n; i++) {
    const to = 16 * i, sh = 16 * n + 8 * shTexels * i, green = two(24 * n + i);
    for (let k = 0; k < 3; k++) {
      const from = 3 * k * n + i;
      at[k] += unfold(two(from) | bytes[from + 2 * n] << 16);
      floats[8 * i + k] = packed.at[k] + packed.reach * Math.sinh(at[k] * packed.step);
    }
    for (let k = 0; k < 4; k++) words[to + 6 + k] = two((9 + 2 * k) * n + i);
    for (let k = 0; k < 3; k++)
      words[to + 10 + k] = 16383 + packed.quat * unfold(two((17 + 2 * k) * n + i)) |
        (bytes[23 * n + i] >> k & 1) << 15;
    words[to + 13] = green + unfold(two(26 * n + i));
    words[to + 14] = green;
    words[to + 15] = green + unfold(two(28 * n + i));
    for (let j = 0; j < 3 * (coefficients - 1); j++)
      words[sh + j] = halves[two((30 + 2 * j) * n + i)];
  }
  return out;
}
