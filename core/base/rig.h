/* rig.h - how large a rig may be: the one bound of all tables of its cameras and boards. */
#ifndef BASE_RIG_H
#define BASE_RIG_H

enum { RIG_CAMERAS_MAX = 128 }; // on one board or on as many boards

#endif
