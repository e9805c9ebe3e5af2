// What make.sh needs in JavaScript: make.mjs truth | old META | ksplat PLY OUT LEVEL
import fs from 'fs';

const N = 48;
const REST = 24; // degree 2, the most that .ksplat has

// The same numbers each time, 0 to 1.
let state = 1;
const random = () => (state = state * 48271 % 2147483647) / 2147483647;

function writeTruth() {
    const names = ['x', 'y', 'z', 'f_dc_0', 'f_dc_1', 'f_dc_2',
        ...Array.from({ length: REST }, (_, i) => `f_rest_${i}`), 'opacity',
        'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3'];
    const head = ['ply', 'format binary_little_endian 1.0', `element vertex ${N}`,
        ...names.map(n => `property float ${n}`), 'end_header', ''].join('\n');
    const rows = new Float32Array(N * names.length);
    for (let i = 0; i < N; i++) {
        const q = [0, 0, 0, 0].map(() => random() - 0.5);
        const length = Math.hypot(...q);
        rows.set([...[0, 0, 0].map(() => 4 * random() - 2),
            ...[0, 0, 0].map(() => 1.6 * random() - 0.8), // colours of 0.27 to 0.73
            ...Array.from({ length: REST }, () => 0.2 * random() - 0.1),
            8 * random() - 4,
            ...[0, 0, 0].map(() => 4 * random() - 6),
            ...q.map(v => v / length)], i * names.length);
    }
    fs.writeFileSync('truth.ply', Buffer.concat([Buffer.from(head), Buffer.from(rows.buffer)]));
}

// Ranges instead of codebooks: the same bytes mean other splats, which is as good for a test.
function makeOld(path) {
    const meta = JSON.parse(fs.readFileSync(path));
    const old = {
        means: { shape: [meta.count, 3], ...meta.means },
        scales: { mins: [-6, -5.5, -5], maxs: [-2, -2.5, -3], files: meta.scales.files },
        quats: { ...meta.quats, encoding: 'quaternion_packed' },
        sh0: { mins: [-0.8, -0.7, -0.6, -4], maxs: [0.8, 0.9, 1, 4], files: meta.sh0.files },
        shN: { mins: -0.1, maxs: 0.12, files: meta.shN.files }
    };
    fs.writeFileSync(path, JSON.stringify(old));
}

// As util/create-ksplat.js of its repository does, which its package lacks.
async function writeKsplat(ply, out, level) {
    globalThis.window = globalThis;
    const lib = await import('@mkkellogg/gaussian-splats-3d');
    const bytes = fs.readFileSync(ply);
    const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
    const splats = await lib.PlyLoader.loadFromFileData(buffer, 1, level, true, 2, 0,
        undefined, 2, 4); // edge of a block, splats of a bucket
    fs.writeFileSync(out, Buffer.from(splats.bufferData));
}

const [what, ...rest] = process.argv.slice(2);
if (what === 'truth')
    writeTruth();
else if (what === 'old')
    makeOld(rest[0]);
else
    await writeKsplat(rest[0], rest[1], Number(rest[2]));
