/* The search of cameras with focus=once, before anything of a take is metered: exposures stay as
 * they are, so that it sees its subject. Afterwards every camera is armed again, for frames of a
 * lens that moved are no reference.
 * A camera that finds no focus spoils the take, as the shutter of a single-shot autofocus camera
 * stays shut: who pressed the button is still there and can press again, a scene of blurred
 * pictures is seen much later. */
#include "firmware/capture/session_inner.h"

#define LOOK_NS INT64_C(100000000) // at the latest, if no frame comes

err_t session_focus(struct session *s, bool again)
{
    bool searching = false;
    if (s->lost)
        return err_fail(ERR_LOST, "a camera was lost while it focused");
    for (int i = 0; i < s->n; i++) {
        const struct cam *c = &s->cam[i];
        err_t e = c->ops->focus ? c->ops->focus(c->st, again) : OK;
        if (e && e != ERR_AGAIN)
            return e; // the sentence names the camera
        searching = searching || e == ERR_AGAIN;
    }
    s->until_ns = session_machine_now(s) + LOOK_NS;
    err_t e = searching ? ERR_AGAIN : OK;
    for (int i = 0; i < s->n && !e && s->phase == PHASE_FOCUS; i++)
        e = session_machine_arm(s, i, 0);
    return e;
}
