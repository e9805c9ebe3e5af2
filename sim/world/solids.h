/* solids.h - the parts of a world: solids with materials, lamps, sun and sky. */
#ifndef WORLD_SOLIDS_H
#define WORLD_SOLIDS_H

#include "core/base/types.h"
#include "sim/world/texture.h"

enum world_shape {
    WORLD_BOX,       // |x| <= size[0], |y| <= size[1], |z| <= size[2]
    WORLD_ELLIPSOID, // half axes size
    WORLD_FRUSTUM,   // along z, |z| <= size[2]; elliptic radii size[0], size[1] at the bottom,
                     // times taper at the top (1 a cylinder, 0 a cone); closed by discs
    WORLD_TORUS,     // around z: radius size[0] of the ring, size[1] of the tube
    WORLD_RECT,      // |x| <= size[0], |y| <= size[1], z = 0; both sides
    WORLD_SHAPES
};

struct world_material {
    struct texture albedo; // diffuse reflectance
    float specular;        // 0..1 reflectance at normal incidence of the gloss layer (0.04 lacquer,
                           // 0.9 mirror)
    float roughness;       // 0 mirror .. 1; of the gloss layer
    float emission[3];     // radiance, >= 0
};

struct world_solid {
    enum world_shape shape;
    float size[3], taper; // m, > 0; 0..1
    float r[9], t[3];     // x_world = r x_local + t, r a rotation, row-major
    float origin[3];      // m; textures are evaluated at x_local + origin, so that solids of one
                          // material differ and the pieces of a wall continue each other
    int material;
};

/* A source from which light is gathered directly: a solid that emits, or a window. */
struct world_light {
    int solid;        // that emits, or -1: an opening to the sky
    float r[9], t[3]; // frame of the opening, z into the room; its rectangle is |x| <= size[0],
                      // |y| <= size[1]
    float size[2];    // m
};

enum world_kind {
    WORLD_ANY = -1, // chosen by the seed
    WORLD_ROOM,     // closed room with windows and lamps
    WORLD_YARD,     // outdoors: ground, walls, trees, sun and sky
    WORLD_DARK,     // room whose only light is a bare lamp; 20 stops of range
    WORLD_PLAIN,    // room without texture
    WORLD_MIRROR,   // room with mirror-like surfaces
    WORLD_PARK,     // outdoors with room all around the subject, far houses and hills
    WORLD_KINDS
};

#define WORLD_WORDS "room|yard|dark|plain|mirror|park" // names of the kinds

struct world {
    enum world_kind kind;
    int n_solids, n_materials, n_lights;
    struct world_solid *solids;
    struct world_material *materials;
    struct world_light *lights;
    float lo[3], hi[3]; // m, box of everything except ground and far walls
    float sun_dir[3];   // unit, towards the sun
    float sun[3];       // irradiance on a plane that faces the sun; 0: no sun
    float sun_cos;      // cosine of the half angle of the sun's disc, for soft shadows
    float sky[2][3];    // radiance at the zenith and at the horizon
    float focus[3];     // m, what a rig should look at
    float stand[2][3];  // m, box in which a camera may stand
    float around;       // m from the focus where cameras may stand on all sides; 0: not possible
};

enum { WORLD_SOLIDS = 1024, WORLD_MATERIALS = 256, WORLD_LIGHTS = 16 };

#endif
