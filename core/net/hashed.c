/* The rules keep activations of a deep random network within a few units and give depths, poses,
 * opacities and tone curves of a plausible size. The first rule that matches a name applies. */
#include "core/net/hashed.h"

#include "core/base/splitmix.h"

#include <math.h>
#include <string.h>

/* Scale and offset of the elements up to `end`. */
struct span {
    float scale, offset;
    size_t end;
};

static bool ends_with(const char *s, const char *with)
{
    size_t n = strlen(s), m = strlen(with);
    return n >= m && strcmp(s + n - m, with) == 0;
}

/* Values of a bias around `offset`. */
static struct span bias_span(size_t end, float offset)
{
    return (struct span){0.02f, offset, end};
}

/* The row of hdr_conv.2 that element i is in: opacity, scales, everything else, confidence. */
static struct span last_conv(size_t i, size_t fan, double he)
{
    size_t row = i / fan;
    if (row < 1)
        return (struct span){(float)(0.7 * he), 0, fan};
    if (row < 4)
        return (struct span){(float)he, 0, 4 * fan};
    if (row < 83)
        return (struct span){(float)(4.0 * he), 0, 83 * fan};
    return (struct span){(float)he, 0, SIZE_MAX};
}

static struct span last_conv_bias(size_t i)
{
    if (i < 1)
        return bias_span(1, 0.5f);
    if (i < 4)
        return bias_span(4, 4.0f);
    if (i == 7)
        return bias_span(8, 1.0f);
    return bias_span(i < 7 ? 7 : SIZE_MAX, 0);
}

/* Per colour w1[64] b1[64] w2[64] b2: a rising curve. */
static struct span curve_span(size_t i)
{
    static const struct span part[4] = {
        {0.5f, 0.5f, 64}, {1.0f, 1.0f, 128}, {0.02f, 0.02f, 192}, {0.25f, -1.5f, 193}};
    size_t colour = i / 193, p = 0;
    if (colour >= 3)
        return (struct span){0.1f, 0, SIZE_MAX};
    while (i - colour * 193 >= part[p].end)
        p++;
    return (struct span){part[p].scale, part[p].offset, colour * 193 + part[p].end};
}

static struct span by_name(const struct tensor_spec *t, double he)
{
    static const struct {
        const char *suffix;
        double of_he, scale; // one of them
        float offset;
    } rules[] = {
        {"camera_head.pose_branch.fc2.weight", 0.05, 0, 0},
        {"depth_head.scratch.output_conv2.2.weight", 0.5, 0, 0},
        {"generate_tonemapper.out.2.weight", 0.1, 0, 0},
        {"hdr_head.regression.exp_film.2.weight", 0.5, 0, 0},
        {"q_norm.weight", 0, 0.1, 1.8f},
        {"k_norm.weight", 0, 0.1, 1.8f},
        {"attn.qkv.weight", 1.25, 0, 0},
        {".gamma", 0, 0.1, 0.25f},
        {"patch_embed.pos_embed", 0, 1.5, 0},
        {"_token", 0, 0.5, 0},
        {"_tokens", 0, 0.5, 0},
        {".bias", 0, 0.02, 0},
        {".model.1.weight", 0, 0.5, 0.5f}, // of LPIPS, >= 0
    };
    static const char features[] = "features."; // of LPIPS: all are followed by ReLU
    if (strncmp(t->name, features, sizeof features - 1) == 0 && t->rank == 4)
        return (struct span){(float)(sqrt(2) * he), 0, SIZE_MAX};
    for (size_t k = 0; k < sizeof rules / sizeof rules[0]; k++)
        if (ends_with(t->name, rules[k].suffix))
            return (struct span){(float)(rules[k].scale + rules[k].of_he * he), rules[k].offset,
                                 SIZE_MAX};
    if (t->rank == 1)
        return (struct span){0.1f, 1, SIZE_MAX}; // a norm's weights
    if (t->role == ROLE_CONV_T)
        return (struct span){(float)sqrt(3.0 / t->shape[0]), 0, SIZE_MAX};
    return (struct span){(float)he, 0, SIZE_MAX};
}

static struct span span_at(const struct tensor_spec *t, size_t i)
{
    const char *name = t->name;
    size_t fan = table_count(t) / (size_t)t->shape[0];
    double he = sqrt(3.0 / (double)fan);
    if (ends_with(name, "camera_head.pose_branch.fc2.bias"))
        return bias_span(i < 6 ? 6 : SIZE_MAX, i < 6 ? 0 : 0.25f);
    if (ends_with(name, "depth_head.scratch.output_conv2.2.bias"))
        return bias_span(i < 1 ? 1 : SIZE_MAX, i < 1 ? 0.8f : 0);
    if (ends_with(name, "hdr_conv.2.weight"))
        return last_conv(i, fan, he);
    if (ends_with(name, "hdr_conv.2.bias"))
        return last_conv_bias(i);
    if (ends_with(name, "generate_tonemapper.out.2.bias"))
        return curve_span(i);
    return by_name(t, he);
}

static float unit_value(uint64_t z)
{
    return (float)((int32_t)(splitmix_mix(z) >> 40) - 8388608) / 8388608.0f;
}

void hashed_fill(const struct tensor_spec *t, uint64_t seed, size_t first, size_t n, float *out)
{
    uint64_t h = 0xCBF29CE484222325u;
    for (const char *c = t->name; *c; c++)
        h = (h ^ (uint8_t)*c) * 0x100000001B3u;
    h += seed * SPLITMIX_STEP;
    for (size_t i = first, end = first + n; i < end;) {
        struct span s = span_at(t, i);
        size_t stop = s.end < end ? s.end : end;
        for (; i < stop; i++) {
            float scaled = s.scale * unit_value(h + (i + 1) * SPLITMIX_STEP);
            out[i - first] = s.offset + scaled;
        }
    }
}
