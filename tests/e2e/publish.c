/* publish HOST PORT CA USER PASSWORD-FILE ACTION TOPIC [TEXT]: a client of a broker with TLS.
 *   say   publish TEXT, not retained, and end
 *   hear  print the messages under the filter TOPIC for 2 s; exit code 1 if there is none
 * Exit code 2: the broker does not let it in; its sentence is on stderr. */
#include "drivers/device/clocks.h"
#include "drivers/net/mqtt.h"

#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { HOST = 1, PORT, CA, USER, PASSWORD, ACTION, TOPIC, TEXT };

#define CONNECT_NS INT64_C(8000000000)
#define HEAR_NS INT64_C(2000000000)

/* The next event; false: none came in time. */
static bool wait_event(struct mqtt *m, int64_t end, struct mqtt_event *ev)
{
    while (clocks_now() < end) {
        struct pollfd p = {.fd = mqtt_fd(m), .events = POLLIN};
        if (mqtt_next(m, ev) == OK)
            return true;
        poll(&p, 1, 50);
    }
    return false;
}

static int hear(struct mqtt *m)
{
    const int64_t end = clocks_now() + HEAR_NS;
    struct mqtt_event ev;
    int heard = 0;
    fputs("listens\n", stderr);
    while (wait_event(m, end, &ev)) {
        if (ev.kind == MQTT_MESSAGE) {
            printf("%s %s\n", ev.topic, ev.payload);
            heard++;
        }
        mqtt_event_free(&ev);
    }
    return heard ? 0 : 1;
}

static int act(struct mqtt *m, int argc, char **argv)
{
    struct mqtt_event ev;
    if (!wait_event(m, clocks_now() + CONNECT_NS, &ev) || ev.kind != MQTT_UP) {
        fprintf(stderr, "%s\n", ev.kind == MQTT_DOWN ? ev.why : "no answer");
        return 2;
    }
    if (strcmp(argv[ACTION], "hear") == 0)
        return hear(m);
    return argc > TEXT && mqtt_publish(m, argv[TOPIC], argv[TEXT], 1, false) == OK ? 0 : 2;
}

int main(int argc, char **argv)
{
    char password[128] = "", client[64];
    struct mqtt *m;
    if (argc <= TOPIC)
        return 3;
    FILE *f = fopen(argv[PASSWORD], "r");
    if (!f || !fgets(password, sizeof password, f))
        return 3;
    fclose(f);
    password[strcspn(password, "\n")] = 0;
    snprintf(client, sizeof client, "publish-%s-%s", argv[USER], argv[ACTION]);
    const struct mqtt_config c = {.host = argv[HOST],
                                  .port = atoi(argv[PORT]),
                                  .tls = true,
                                  .ca = argv[CA],
                                  .user = argv[USER],
                                  .password = password,
                                  .client = client};
    signal(SIGPIPE, SIG_IGN);
    if (mqtt_open(&c, &m) != OK ||
        (strcmp(argv[ACTION], "hear") == 0 && mqtt_subscribe(m, argv[TOPIC], 1) != OK)) {
        fprintf(stderr, "%s\n", err_text());
        return 2;
    }
    const int code = act(m, argc, argv);
    mqtt_close(m);
    return code;
}
