/* amx_emu.h - the instructions of Intel AMX on processors without: each raises SIGILL, and a
 * handler does what it would have done (Intel SDM vol. 2: LDTILECFG, TILELOADD, TILESTORED,
 * TILEZERO, TDPBSSD, TILERELEASE). So the very machine code is tested. What the processor answers
 * with a fault ends the test. For tests only; one thread; after guard_trap. */
#ifndef KERNELS_AMX_EMU_H
#define KERNELS_AMX_EMU_H

#include "tests/kernels/guard.h"

#include <stddef.h>
#include <ucontext.h>

enum { EMU_TILES = 8, EMU_ROWS = 16, EMU_BYTES = 64 };

static struct {
    bool configured;
    int rows[EMU_TILES], bytes[EMU_TILES];
    uint8_t data[EMU_TILES][EMU_ROWS][EMU_BYTES];
} emu;

static inline void emu_need(bool condition, const char *what)
{
    if (condition)
        return;
    fprintf(stderr, "tile instruction: %s\n", what);
    exit(1);
}

static inline void emu_configure(const uint8_t *c)
{
    memset(&emu, 0, sizeof emu);
    emu_need(c[0] == 1, "palette is not 1");
    emu_need(c[1] == 0, "start row is not 0");
    for (int i = 2; i < 64; i++) {
        bool reserved = i < 16 || (i >= 32 && i < 48) || i >= 56;
        emu_need(!reserved || c[i] == 0, "reserved byte of the configuration is not 0");
    }
    for (int t = 0; t < EMU_TILES; t++) {
        emu.bytes[t] = c[16 + 2 * t] | c[17 + 2 * t] << 8;
        emu.rows[t] = c[48 + t];
        emu_need(emu.bytes[t] <= EMU_BYTES && emu.rows[t] <= EMU_ROWS, "tile too large");
        emu_need((emu.bytes[t] == 0) == (emu.rows[t] == 0), "tile with rows or bytes alone");
    }
    emu.configured = true;
}

static inline void emu_tile(int t)
{
    emu_need(emu.configured, "no configuration");
    emu_need(t >= 0 && t < EMU_TILES && emu.rows[t] > 0, "tile is not configured");
}

static inline void emu_zero(int t)
{
    emu_tile(t);
    memset(emu.data[t], 0, sizeof emu.data[t]);
}

static inline void emu_load(int t, const uint8_t *from, ptrdiff_t stride)
{
    emu_zero(t);
    for (int r = 0; r < emu.rows[t]; r++)
        memcpy(emu.data[t][r], from + r * stride, (size_t)emu.bytes[t]);
}

static inline void emu_store(int t, uint8_t *to, ptrdiff_t stride)
{
    emu_tile(t);
    for (int r = 0; r < emu.rows[t]; r++)
        memcpy(to + r * stride, emu.data[t][r], (size_t)emu.bytes[t]);
}

static inline void emu_dpbssd(int c, int a, int b)
{
    emu_tile(c);
    emu_tile(a);
    emu_tile(b);
    emu_need(c != a && c != b && a != b, "a tile is named twice");
    emu_need((emu.bytes[a] | emu.bytes[b] | emu.bytes[c]) % 4 == 0, "row of broken words");
    emu_need(emu.rows[c] == emu.rows[a], "rows of sums and activations differ");
    emu_need(emu.bytes[c] == emu.bytes[b], "columns of sums and weights differ");
    emu_need(emu.bytes[a] / 4 == emu.rows[b], "inputs of activations and weights differ");
    for (int m = 0; m < emu.rows[c]; m++)
        for (int n = 0; n < emu.bytes[c] / 4; n++) {
            uint32_t sum;
            memcpy(&sum, emu.data[c][m] + 4 * n, sizeof sum);
            for (int k = 0; k < emu.bytes[a]; k++)
                sum += (uint32_t)((int8_t)emu.data[a][m][k] *
                                  (int8_t)emu.data[b][k / 4][4 * n + k % 4]);
            memcpy(emu.data[c][m] + 4 * n, &sum, sizeof sum);
        }
}

/* An instruction with a VEX prefix of three bytes in the map 0F38. */
struct emu_op {
    int prefix, opcode;   // 0 none, 1 66, 2 F3, 3 F2
    int mod, reg, rm, v;  // register numbers
    ptrdiff_t base, step; // for a memory operand: address; index times scale
};

static inline ptrdiff_t emu_register(const ucontext_t *u, int number)
{
    static const int order[] = {REG_RAX, REG_RCX, REG_RDX, REG_RBX, REG_RSP, REG_RBP,
                                REG_RSI, REG_RDI, REG_R8,  REG_R9,  REG_R10, REG_R11,
                                REG_R12, REG_R13, REG_R14, REG_R15};
    return (ptrdiff_t)u->uc_mcontext.gregs[order[number]];
}

/* Decode and step over it; false if it is none of ours. */
static inline bool emu_decode(ucontext_t *u, struct emu_op *o)
{
    const uint8_t *p = (const uint8_t *)u->uc_mcontext.gregs[REG_RIP];
    if (p[0] != 0xc4 || (p[1] & 0x1f) != 2 || (p[2] & 0x84) != 0)
        return false;
    int x = p[1] & 0x40 ? 0 : 8, b = p[1] & 0x20 ? 0 : 8;
    *o = (struct emu_op){.prefix = p[2] & 3,
                         .opcode = p[3],
                         .mod = p[4] >> 6,
                         .reg = p[4] >> 3 & 7,
                         .rm = p[4] & 7,
                         .v = ~p[2] >> 3 & 15};
    p += 5;
    if (o->mod != 3) {
        int base = o->rm + b;
        if (o->rm == 4) { // SIB; index 4 is none
            int index = (*p >> 3 & 7) + x;
            base = (*p & 7) + b;
            emu_need((*p & 7) != 5 || o->mod != 0, "address without base");
            o->step = index == 4 ? 0 : emu_register(u, index) * (1 << (*p >> 6));
            p++;
        }
        emu_need(o->rm != 5 || o->mod != 0, "address relative to the instruction");
        int32_t wide = 0;
        if (o->mod == 2)
            memcpy(&wide, p, sizeof wide);
        o->base = emu_register(u, base) + (o->mod == 1 ? (int8_t)*p : wide);
        p += o->mod == 1 ? 1 : o->mod == 2 ? 4 : 0;
    }
    u->uc_mcontext.gregs[REG_RIP] = (greg_t)p;
    return true;
}

static inline void emu_signal(int number, siginfo_t *info, void *context)
{
    struct emu_op o;
    (void)info;
    if (!guard_armed || !emu_decode(context, &o)) {
        guard_signal(number);
        return;
    }
    bool memory = o.mod != 3;
    if (o.opcode == 0x49 && o.prefix == 0 && memory)
        emu_configure((const uint8_t *)(o.base + o.step));
    else if (o.opcode == 0x49 && o.prefix == 0)
        emu.configured = false;
    else if (o.opcode == 0x49 && o.prefix == 3 && !memory)
        emu_zero(o.reg);
    else if (o.opcode == 0x4b && o.prefix == 3 && memory && o.rm == 4)
        emu_load(o.reg, (const uint8_t *)o.base, o.step);
    else if (o.opcode == 0x4b && o.prefix == 2 && memory && o.rm == 4)
        emu_store(o.reg, (uint8_t *)o.base, o.step);
    else if (o.opcode == 0x5e && o.prefix == 3 && !memory)
        emu_dpbssd(o.reg, o.rm, o.v);
    else
        emu_need(false, "unknown");
}

/* Take over SIGILL. */
static inline void emu_start(void)
{
    struct sigaction action = {.sa_sigaction = emu_signal, .sa_flags = SA_SIGINFO};
    if (sigaction(SIGILL, &action, NULL) != 0) {
        perror("sigaction");
        exit(1);
    }
}

#endif
