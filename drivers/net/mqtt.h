/* mqtt.h - messages to and from a broker by MQTT 5, through libmosquitto. A thread of its own finds
 * the broker, connects, and connects again for ever; what happens comes out as events in the order
 * in which it happened, and a descriptor says when to look. No function waits for the network, and
 * mqtt_close for 3 s at most.
 * Messages of one client under one topic arrive in their order if all have the same QoS.
 * Passwords appear in no sentence. SIGPIPE must be ignored.
 * thread: all functions from one thread. */
#ifndef NET_MQTT_H
#define NET_MQTT_H

#include "core/base/err.h"

#include <stdbool.h>
#include <stddef.h>

enum {
    MQTT_TOPIC_CAP = 128, // bytes of a topic or filter with its terminating 0
    MQTT_HOST_CAP = 256,
    MQTT_WHY_CAP = 256,
    MQTT_PAYLOAD_MAX = 1 << 16, // bytes of a message; longer ones do not arrive
    MQTT_EVENTS_MAX = 1024,     // that wait; then each new one takes the place of an old message
    MQTT_FILTERS_MAX = 32,
    MQTT_KEEPALIVE_S = 5 // the broker takes a silent client for dead after 1.5 of it
};

struct mqtt_url {
    char host[MQTT_HOST_CAP];
    int port;
    bool tls;
};

struct mqtt_config { // strings are copied
    const char *host;
    int port;
    bool tls;                    // verify that the broker is `host`, by a certificate of `ca`
    const char *ca;              // PEM file, read at each connection
    const char *user, *password; // NULL: none
    const char *client;          // its name, which no other client of the broker may have
    const char *will_topic;      // NULL: none. The broker publishes `will` there, retained, QoS 1,
    const char *will;            // when the connection ends in any way but mqtt_close
};

enum mqtt_kind {
    MQTT_UP,     // connected; messages of before may have been missed
    MQTT_DOWN,   // not connected; comes once for each reason while attempts fail
    MQTT_MESSAGE // under a filter of mqtt_subscribe
};

struct mqtt_event {
    enum mqtt_kind kind;
    bool retained;              // a message of earlier, which the broker has kept
    char topic[MQTT_TOPIC_CAP]; // of a message
    char *payload;              // n bytes and a 0; NULL unless a message
    size_t n;
    char why[MQTT_WHY_CAP]; // DOWN: a sentence, "broker HOST:PORT: Connection refused"
};

struct mqtt;

/* "mqtt://HOST[:PORT]", or "mqtts://" for TLS; an IPv6 address stands in brackets.
 * err:  ERR_ARG */
MUST_USE err_t mqtt_parse_url(const char *url, struct mqtt_url *out);

/* Returns before it is connected: see the events.
 * own:  mqtt_close.
 * err:  ERR_ARG (a value of cfg), ERR_IO (ca cannot be read), ERR_NOMEM. On error *out is NULL. */
MUST_USE err_t mqtt_open(const struct mqtt_config *cfg, struct mqtt **out);

/* What was published is sent first, if the broker takes it within 1 s; the will is not. Accepts
 * NULL. */
void mqtt_close(struct mqtt *m);

int mqtt_fd(const struct mqtt *m); // readable when an event waits

/* own:  mqtt_event_free.
 * err:  ERR_AGAIN */
MUST_USE err_t mqtt_next(struct mqtt *m, struct mqtt_event *out);

/* Accepts a zeroed event. */
void mqtt_event_free(struct mqtt_event *e);

/* Now if connected, and at each connection from now on. A filter given before gets the new QoS.
 * err:  ERR_ARG (filter, qos), ERR_LIMIT (MQTT_FILTERS_MAX), ERR_NOMEM */
MUST_USE err_t mqtt_subscribe(struct mqtt *m, const char *filter, int qos);

/* Send the bytes of `text`. OK means that it will be sent, not that it arrived: a connection that
 * is lost at the same time takes it along, and the event MQTT_DOWN follows. Nothing is sent again
 * at the next connection. An empty text with `retain` removes what the broker keeps.
 * err:  ERR_LOST (not connected), ERR_ARG (topic, qos), ERR_LIMIT (longer than MQTT_PAYLOAD_MAX or
 *       than the broker takes), ERR_NOMEM */
MUST_USE err_t mqtt_publish(struct mqtt *m, const char *topic, const char *text, int qos,
                            bool retain);

/* Our own IP address on the connection to the broker, as text.
 * err:  ERR_LOST (not connected), ERR_LIMIT (cap), ERR_IO */
MUST_USE err_t mqtt_address(const struct mqtt *m, char *out, size_t cap);

#endif
