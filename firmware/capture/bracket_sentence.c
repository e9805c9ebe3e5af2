/* Why a bracket ended, in words. */
#include "firmware/capture/bracket.h"

const char *bracket_sentence(enum bracket_reason r)
{
    static const char *const sentences[BRACKET_REASONS] = {
        [BRACKET_NONE] = "nothing is wrong",
        [BRACKET_DEVICE_LOST] = "the camera was unplugged",
        [BRACKET_STALLED] = "the camera sends no frames, not even after a restart",
        [BRACKET_INEFFECTIVE] = "the camera accepts the exposure, but its pictures do not show it",
        [BRACKET_SCENE_CHANGED] = "the light or the scene changed twice during the bracket",
        [BRACKET_DISAGREES] = "the camera reports an exposure that the pictures do not have",
        [BRACKET_GAINS] = "the camera changes its digital gain or white balance by itself",
        [BRACKET_BAD_FRAMES] = "too many frames are lost or damaged",
        [BRACKET_REFUSED] = "the camera refuses the exposure",
        [BRACKET_CANCELLED] = "cancelled",
    };
    return r >= 0 && r < BRACKET_REASONS ? sentences[r] : "unknown";
}
