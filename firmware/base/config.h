/* config.h - settings as key = value.
 * Order, later wins: built-in defaults, defaults.conf, board.conf, hdrig.conf, --set. The table of
 * keys in config.c drives parsing, range errors and printing. A setting is a whole number, one of
 * some words (kept as its position), or a text; numbered keys (camera.1, camera.2, ...) are arrays.
 * Files are hostile: at most CONFIG_FILE_MAX bytes, lines below 200 bytes, unknown keys are
 * errors. */
#ifndef BASE_CONFIG_H
#define BASE_CONFIG_H

#include "core/base/err.h"
#include "core/base/rig.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

#define CONFIG_DIR "/etc/hdrig" // where `make install` puts defaults.conf and board.conf

enum { CONFIG_FILE_MAX = 16384 }; // bytes

/* bytes with 0; numbers of each; stops */
enum { CONFIG_TEXT = 200, CONFIG_CAMERAS = 16, CONFIG_TRIGGERS = 4, CONFIG_STOPS_MAX = 16 };
enum { CONFIG_MEMBERS = RIG_CAMERAS_MAX };

enum { CONFIG_SIZE_AUTO = 0, CONFIG_SIZE_FULL = -1 };
enum config_bracket { CONFIG_AUTO, CONFIG_LIST };
enum config_collect { CONFIG_COLLECT_AUTO, CONFIG_COLLECT_NO, CONFIG_COLLECT_YES };
enum config_role { CONFIG_ALONE, CONFIG_MEMBER, CONFIG_CONDUCTOR };
enum config_busy { CONFIG_REJECT, CONFIG_QUEUE, CONFIG_COALESCE };

struct config {
    int threads;       // 0 = one per core
    int max_memory_mb; // MB (10^6 bytes); 0 = by the machine, see config_memory_mb
    int size;          // px, longer edge of the pictures that scenes are made of, or CONFIG_SIZE_
    int seed;
    int job_budget_s;     // 0: any
    int job_checkpoint_s; // 0: none
    int refine_steps;
    int refine_sh_degree_max; // 0..4
    int refine_gaussians_max;
    int cameras_polish, cameras_fov_deg;
    int cameras_lens; // enum recipe_lens
    int cameras_principal;
    int cameras_same; // enum physcam_rule
    int start_stereo;
    int net_float_parts; // NET_FLOAT_ bits of core/net/net.h

    /* the rig; "": not set */
    char rig_file[CONFIG_TEXT];
    int rig_moved; // enum recipe_moved
    int rig_role;  // enum config_role
    char rig_name[CONFIG_TEXT], rig_broker[CONFIG_TEXT], rig_board[CONFIG_TEXT];
    char rig_password_file[CONFIG_TEXT], rig_ca[CONFIG_TEXT];
    char rig_member[CONFIG_MEMBERS][CONFIG_TEXT]; // names of boards
    char rig_meter[CONFIG_TEXT];
    int rig_partial;
    char camera[CONFIG_CAMERAS][CONFIG_TEXT]; // URIs
    int camera_w, camera_h;                   // px; 0: the camera's own
    int camera_format;                        // enum camera_format
    char trigger[CONFIG_TRIGGERS][CONFIG_TEXT];
    int trigger_lockout_ms, trigger_busy, trigger_queue; // enum config_busy; presses that wait
    int session_collect, session_hold_ms;                // enum config_collect
    char lamp[CONFIG_TEXT];
    int bracket_mode; // enum config_bracket
    char bracket_ev[CONFIG_TEXT];
    int bracket_middle_us, bracket_stagger, bracket_snr_db, bracket_skew_ms, bracket_moved;
    /* the daemon */
    char store_path[CONFIG_TEXT], calibration_path[CONFIG_TEXT], results_path[CONFIG_TEXT];
    int store_reserve_mb, store_keep, store_merge;
    int job_run;
    char job_launcher[CONFIG_TEXT];
    char control_socket[CONFIG_TEXT];
    int http_port;
    char http_address[CONFIG_TEXT], http_token[CONFIG_TEXT], http_token_file[CONFIG_TEXT];
};

/* Whether captures are collected as places of one scene (firmware/store/places.h). */
bool config_collects(const struct config *c);

/* The built-in values, the same as board/common/defaults.conf. */
void config_defaults(struct config *c);

/* Read defaults.conf, board.conf and hdrig.conf of `dir`, those that exist, over the values in *c.
 * err:  as config_read. */
MUST_USE err_t config_load(struct config *c, const char *dir);

/* Read one file over the values in *c.
 * err:  ERR_IO; ERR_FORMAT with file name and line number. On error *c is unchanged. */
MUST_USE err_t config_read(struct config *c, const char *path);

/* As config_read for `size` bytes in memory; `name` is for sentences. */
MUST_USE err_t config_parse(struct config *c, const char *name, const char *text, size_t size);

/* Set one key; `where` says in the sentence where the value came from ("--threads").
 * err:  ERR_ARG: unknown key, not a whole number, out of range, none of the words, no plain text.
 *       On error *c is unchanged. */
MUST_USE err_t config_set(struct config *c, const char *where, const char *key, const char *value);

/* As config_set for "key=value", the argument of --set. */
MUST_USE err_t config_assign(struct config *c, const char *text);

/* Whether an address is of this machine alone. */
bool config_is_loopback(const char *address);

/* Stops of bracket.ev into ev, which has room for cap; the number, 0 if there are none.
 * err:  ERR_ARG names the word and the range, or that there are too many. */
MUST_USE err_t config_stops(const char *where, const char *text, double *ev, int cap, int *n);

/* Memory bound of a job, MB (10^6 bytes): max_memory_mb, or three quarters of memory_total; the
 * rest is for the system and for memory outside the plans. */
int config_memory_mb(const struct config *c);

/* Check keys against each other: settings of the rig and the daemon that contradict each other.
 * err:  ERR_ARG names both keys. */
MUST_USE err_t config_check_rig(const struct config *c);

/* Every key with its help and range, in the form that config_read takes.
 * err:  ERR_IO. */
MUST_USE err_t config_print(const struct config *c, FILE *out);

#endif
