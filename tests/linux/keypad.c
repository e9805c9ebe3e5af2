/* A keyboard that is a program, through uinput: keypad OPERATION...
 *   press CODE MS     down for so long, and up
 *   down CODE | up CODE
 *   nap MS
 *   flood N           presses of KEY_ENTER at once
 * It has the keys ENTER, SPACE and A, repeats those that are held as a keyboard does, and is pulled
 * out at the end. */
#include <fcntl.h>
#include <linux/uinput.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

static int device;

static void check(int r, const char *what)
{
    if (r < 0) {
        perror(what);
        exit(2);
    }
}

static void emit(int type, int code, int value)
{
    struct input_event ev = {.type = (__u16)type, .code = (__u16)code, .value = value};
    check(write(device, &ev, sizeof ev) == sizeof ev ? 0 : -1, "keypad: event");
}

static void key(int code, int value)
{
    emit(EV_KEY, code, value);
    emit(EV_SYN, SYN_REPORT, 0);
}

static void nap(int ms)
{
    nanosleep(&(struct timespec){ms / 1000, ms % 1000 * 1000000L}, NULL);
}

static void plug(void)
{
    static const int keys[] = {KEY_ENTER, KEY_SPACE, KEY_A};
    struct uinput_setup setup = {.id = {BUS_USB, 0x1209, 0xcadb, 1}, .name = "hdrig keypad"};
    device = open("/dev/uinput", O_WRONLY | O_CLOEXEC);
    check(device, "keypad: /dev/uinput");
    check(ioctl(device, UI_SET_EVBIT, EV_KEY), "keypad: keys");
    check(ioctl(device, UI_SET_EVBIT, EV_REP), "keypad: repeats");
    for (size_t i = 0; i < sizeof keys / sizeof keys[0]; i++)
        check(ioctl(device, UI_SET_KEYBIT, keys[i]), "keypad: key");
    check(ioctl(device, UI_DEV_SETUP, &setup), "keypad: setup");
    check(ioctl(device, UI_DEV_CREATE), "keypad: create");
}

int main(int argc, char **argv)
{
    plug();
    for (int i = 1; i + 1 < argc; i += 2) {
        const char *what = argv[i];
        int n = atoi(argv[i + 1]);
        if (!strcmp(what, "nap")) {
            nap(n);
        } else if (!strcmp(what, "down") || !strcmp(what, "up")) {
            key(n, what[0] == 'd');
        } else if (!strcmp(what, "flood")) {
            for (int k = 0; k < 2 * n; k++)
                key(KEY_ENTER, k % 2 == 0);
        } else if (!strcmp(what, "press") && i + 2 < argc) {
            key(n, 1);
            nap(atoi(argv[++i + 1]));
            key(n, 0);
        } else {
            fprintf(stderr, "keypad: no operation %s\n", what);
            return 2;
        }
    }
    close(device);
    return 0;
}
