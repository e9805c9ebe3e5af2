/* cmd_rig.h - the commands behind hdrig rig; argv[0] is the word that names the command. */
#ifndef CMD_CMD_RIG_H
#define CMD_CMD_RIG_H

#include "firmware/cmd/cmd.h"

int cmd_rig_board(int argc, char **argv);
int cmd_rig_calibrate(int argc, char **argv);
int cmd_rig_status(int argc, char **argv);
int cmd_rig_status_hosts(int argc, char **argv);
int cmd_rig_status_capture(int argc, char **argv);
int cmd_rig_status_accept(int argc, char **argv);
int cmd_rig_status_forget(int argc, char **argv);
int cmd_rig_setup_broker(int argc, char **argv);
int cmd_rig_setup_add(int argc, char **argv);
int cmd_rig_setup_remove(int argc, char **argv);
int cmd_rig_setup_join(int argc, char **argv);

/* The word before the options, which is taken out of *argc and *argv; "" if there is none. */
char *cmd_rig_word(int *argc, char ***argv);

#endif
