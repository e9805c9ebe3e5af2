/* Rigs of boards under faults, in virtual time: rig_world.h checks what must always hold. */
#include "tests/unit/firmware/rig/rig_world.h"

#include <stdio.h>

static struct world *ready_world(int members, uint64_t seed)
{
    struct world *w = world_open(members, seed);
    world_run(w, 10);
    assert_int_equal(w->leader.state, CONDUCTOR_LEADS);
    assert_int_equal(conductor_check(&w->leader, mono(w, LEADER)), OK);
    return w;
}

/* Parts that came after a partial take was joined without them stay, until they are given up. */
static void forget_late_parts(struct world *w)
{
    w->gives_up = true;
    for (int k = 0; k < w->n; k++) {
        struct node *n = &w->node[k];
        const int held = n->n_holds;
        for (int i = held - 1; i >= 0; i--) {
            const struct disk_take *d = disk_find(w, n->hold[i].take);
            assert_true((w->set.rig_partial || d->accepted) && d->committed);
            assert_false(leader_has(w, n->hold[i].take, n->name));
            struct conductor_event ev = {.kind = CONDUCTOR_FORGET, .take = n->hold[i].take};
            assert_int_equal(leader_event(w, ev), OK);
        }
    }
    world_run(w, 10);
    w->gives_up = false;
}

/* A take that waits for its owner is joined of what there is, or given up. */
static void owner_decides(struct world *w, double share)
{
    char text[TAKE_TEXT];
    for (int i = 0; i < CONDUCTOR_TAKES && w->node[LEADER].alive; i++) {
        const struct conductor_take *t = &w->leader.take[i];
        if (!conductor_parts_choice(&w->leader, t, text) || chance(w) > share)
            continue;
        struct disk_take *d = disk_find(w, t->order.take);
        assert_non_null(strstr(text, t->order.take));
        struct conductor_event ev = {.kind = CONDUCTOR_ACCEPT, .take = d->order.take};
        if (chance(w) < 0.3)
            ev.kind = CONDUCTOR_FORGET;
        const err_t e = leader_event(w, ev);
        assert_true(!e || (e == ERR_LOST && ev.kind == CONDUCTOR_ACCEPT));
        d->accepted = d->accepted || (!e && ev.kind == CONDUCTOR_ACCEPT);
        w->accepts += !e && ev.kind == CONDUCTOR_ACCEPT;
    }
}

static void finish(struct world *w)
{
    world_heal(w);
    world_run(w, 400);
    owner_decides(w, 1);
    world_run(w, 100);
    assert_int_equal(w->waits, 0);
    assert_int_equal(open_takes(w), 0);
    forget_late_parts(w);
    assert_int_equal(open_holds(w), 0);
    for (int i = 0; i < w->n_disk; i++)
        assert_false(w->disk[i].pending);
}

/* ---- the rules of a member, one by one ---- */

static struct member lone;

static bool acts(enum member_action_kind kind)
{
    struct member_action a;
    bool found = false;
    while (member_action(&lone, &a))
        found = found || a.kind == kind;
    return found;
}

static void lone_starts(void)
{
    const struct message_conductor c = {
        .online = true, .epoch = "a1", .board = "b", .version = "1"};
    member_init(&lone, "left");
    member_event(&lone, &(struct member_event){.kind = MEMBER_UP});
    member_event(&lone, &(struct member_event){.kind = MEMBER_CONDUCTOR, .conductor = &c});
    assert_true(acts(MEMBER_ANNOUNCE));
}

static struct message_order lone_order(int64_t serial)
{
    struct message_order o = {.kind = MESSAGE_SHOOT,
                              .epoch = "a1",
                              .serial = serial,
                              .take = "0123abcd-000001",
                              .n = 1,
                              .start_ns = 5 * SECOND,
                              .n_times = 1,
                              .time_s = {0.01}};
    strcpy(o.member[0], "left");
    return o;
}

static void hear(const struct message_order *o, bool known, int64_t common_ns)
{
    member_event(&lone, &(struct member_event){.kind = MEMBER_ORDER,
                                               .order = o,
                                               .common_known = known,
                                               .common_ns = common_ns});
}

static void test_orders_that_are_not_followed(void **state)
{
    struct message_order o = lone_order(1);
    (void)state;
    lone_starts();
    strcpy(o.epoch, "a2"); // of a conductor that does not lead
    hear(&o, true, 0);
    assert_false(acts(MEMBER_SHOOT));
    o = lone_order(1);
    strcpy(o.member[0], "right");
    hear(&o, true, 0);
    assert_false(acts(MEMBER_SHOOT));
    o = lone_order(1);
    hear(&o, false, 0);
    assert_true(acts(MEMBER_REPORT));
    assert_non_null(strstr(lone.report.reason, "common clock is not known"));
    o = lone_order(2);
    hear(&o, true, 8 * SECOND);
    assert_false(acts(MEMBER_SHOOT));
    assert_non_null(strstr(lone.report.reason, "came 3.0 s after"));
}

static void test_orders_that_come_again(void **state)
{
    struct message_order o = lone_order(3), next = lone_order(4);
    struct message_report stored = {.part = "00000001-000001"};
    struct message_hold hold = {.take = "0123abcd-000001", .part = "00000001-000001"};
    (void)state;
    lone_starts();
    hear(&o, true, 0);
    assert_true(acts(MEMBER_SHOOT));
    hear(&o, true, 0);
    assert_false(acts(MEMBER_SHOOT));
    strcpy(next.take, "0123abcd-000002");
    hear(&next, true, 0);
    assert_false(acts(MEMBER_SHOOT));
    assert_non_null(strstr(lone.report.reason, "another order"));
    member_event(&lone, &(struct member_event){.kind = MEMBER_STORED, .report = &stored});
    assert_true(acts(MEMBER_REPORT));
    assert_int_equal(lone.report.serial, 3);
    hear(&o, true, 0); // its report is said again
    assert_true(acts(MEMBER_REPORT));
    hear(&(struct message_order){.kind = MESSAGE_RELEASE}, true, 0);
    assert_false(acts(MEMBER_RELEASE));

    lone_starts(); // after a restart serials are forgotten, and parts are on the disk
    member_event(&lone, &(struct member_event){.kind = MEMBER_HOLDS, .hold = &hold, .n_holds = 1});
    hear(&o, true, 0);
    assert_false(acts(MEMBER_SHOOT));
    assert_int_equal(lone.report.kind, MESSAGE_STORED);
    assert_string_equal(lone.report.part, hold.part);
}

/* ---- rigs ---- */

static void test_press_becomes_a_take(void **state)
{
    static const int members[] = {1, 4, 16, 100, 128};
    (void)state;
    for (int i = 0; i < 5; i++) {
        struct world *w = ready_world(members[i], 7);
        assert_true(world_press(w));
        assert_false(world_press(w));
        assert_non_null(strstr(err_text(), "a capture runs"));
        world_run(w, 20);
        assert_int_equal(w->joints, 1);
        assert_int_equal(w->told, 1);
        finish(w);
        world_close(w);
    }
}

static void refused(struct world *w, const char *words)
{
    assert_false(world_press(w));
    if (!strstr(err_text(), words))
        fail_msg("\"%s\" does not say \"%s\"", err_text(), words);
}

static void test_presses_that_are_refused(void **state)
{
    (void)state;
    struct world *w = world_open(4, 3);
    refused(w, "broker is not reached");
    world_run(w, 10);
    kill_node(w, 2, 30);
    world_run(w, 8);
    refused(w, "board-02 is not there since");
    world_run(w, 60);
    assert_true(world_press(w));
    world_run(w, 20);
    assert_int_equal(w->joints, 1);
    w->set.bracket_skew_ms = 20;
    w->node[1].said.within_ns = 40 * MS;
    struct conductor_event ev = {
        .kind = CONDUCTOR_MEMBER, .name = "board-01", .member = &w->node[1].said};
    assert_int_equal(leader_event(w, ev), OK);
    refused(w, "board-01 knows the rig's time only within 40 ms");
    strcpy(w->node[1].said.version, "2");
    assert_int_equal(leader_event(w, ev), OK);
    refused(w, "board-01 runs hdrig 2, the conductor 1");
    w->set.bracket_skew_ms = 0;
    world_run(w, 5);
    w->node[1].said.cameras = 126;
    assert_int_equal(leader_event(w, ev), OK);
    refused(w, "the rig has 129 cameras, at most 128 are possible");
    w->node[1].said.cameras = 125;
    assert_int_equal(leader_event(w, ev), OK);
    assert_true(world_press(w));
    finish(w);
    world_close(w);
}

static void test_boards_that_meter(void **state)
{
    (void)state;
    struct world *w = ready_world(4, 5);
    strcpy(w->set.rig_meter, "board-03 board-01");
    assert_true(world_press(w));
    world_run(w, 0.1);
    for (int k = 0; k < 4; k++)
        assert_int_equal(w->node[k].works, k == 1 || k == 3);
    world_run(w, 20);
    assert_int_equal(w->joints, 1);
    strcpy(w->set.rig_meter, "board-0 oard-01 board-011"); // none of these
    refused(w, "none of rig.meter");
    w->set.rig_meter[0] = 0;
    assert_true(world_press(w));
    finish(w);
    world_close(w);
}

static void test_member_dies_while_it_shoots(void **state)
{
    (void)state;
    struct world *w = ready_world(4, 5);
    w->set.bracket_mode = CONFIG_LIST;
    w->set.bracket_middle_us = 10000;
    assert_true(world_press(w));
    world_run(w, 0.3);
    kill_node(w, 1, 5);
    world_run(w, 60);
    assert_int_equal(w->joints, 0);
    assert_int_equal(w->told, 1);
    assert_string_equal(w->last, "board-01: was started again while it photographed; 3 of 4 parts "
                                 "are there: hdrig rig accept 0123abcd-000101 joins these, hdrig "
                                 "rig forget 0123abcd-000101 gives them up");
    assert_true(world_press(w));
    world_run(w, 20);
    assert_int_equal(w->joints, 1);
    assert_int_equal(open_takes(w), 1); // for its owner
    struct conductor_event ev = {.kind = CONDUCTOR_FORGET, .take = "0123abcd-000101"};
    assert_int_equal(leader_event(w, ev), OK);
    finish(w);
    assert_int_equal(w->joints, 1);
    world_close(w);
}

static err_t accept(struct world *w, const char *take)
{
    struct conductor_event ev = {.kind = CONDUCTOR_ACCEPT, .take = take};
    const err_t e = leader_event(w, ev);
    if (!e)
        disk_find(w, take)->accepted = true;
    return e;
}

/* A press whose board 3 is cut off once its part is stored; four boards. */
static struct world *cut_world(uint64_t seed)
{
    struct world *w = ready_world(4, seed);
    w->set.bracket_mode = CONFIG_LIST;
    w->set.bracket_middle_us = 10000;
    assert_true(world_press(w));
    world_run(w, 0.6);
    cut_link(w, 3, 100000);
    world_run(w, 60);
    assert_int_equal(w->joints, 0);
    assert_int_equal(w->told, 0);
    return w;
}

static void plug_in(struct world *w, int k)
{
    w->node[k].linked = true;
    world_run(w, 30);
}

/* Its daemon hangs, or the broker throws it out: no last will tells of it. */
static void test_board_that_falls_silent(void **state)
{
    (void)state;
    struct world *w = ready_world(4, 12);
    w->node[2].up = w->node[2].linked = false;
    world_run(w, 15);
    assert_int_equal(conductor_check(&w->leader, mono(w, LEADER)), OK);
    assert_true(conductor_deadline(&w->leader, mono(w, LEADER)) < mono(w, LEADER) + 6 * SECOND);
    world_run(w, 10);
    refused(w, "board-02 is not there since 4 s");
    const struct conductor_event forget = {.kind = CONDUCTOR_FORGET, .take = "board-02"};
    assert_int_equal(leader_event(w, forget), ERR_ARG); // the settings list it
    w->leader.member[2].listed = false;
    assert_int_equal(leader_event(w, forget), OK);
    assert_int_equal(w->leader.n, 3);
    assert_int_equal(conductor_check(&w->leader, mono(w, LEADER)), OK);
    plug_in(w, 2);
    assert_int_equal(w->leader.n, 4);
    assert_int_equal(conductor_check(&w->leader, mono(w, LEADER)), OK);
    finish(w);
    world_close(w);
}

/* Somebody deletes the part of a board that is away: the others' parts stay until the owner says
 * what is to become of them. */
static void test_lost_part_waits_for_the_owner(void **state)
{
    (void)state;
    struct world *w = cut_world(11);
    char text[TAKE_TEXT];
    struct part lost = w->node[3].hold[0];
    w->node[3].n_holds = 0;
    member_holds(w, 3);
    plug_in(w, 3);
    assert_int_equal(w->told, 1);
    assert_non_null(strstr(w->last, "board-03: lost its part; 3 of 4 parts are there: hdrig rig "
                                    "accept 0123abcd-000101"));
    assert_int_equal(open_holds(w), 3);
    kill_node(w, LEADER, 5); // over a restart
    world_run(w, 60);
    assert_int_equal(open_holds(w), 3);
    assert_true(conductor_parts_choice(&w->leader, &w->leader.take[0], text));
    assert_non_null(strstr(text, "board-03: lost its part"));
    assert_int_equal(accept(w, "0123abcd-000102"), ERR_ARG);
    assert_int_equal(accept(w, "0123abcd-000101"), OK);
    world_run(w, 20);
    assert_int_equal(w->joints, 1);
    assert_string_equal(w->last, "board-03: lost its part");
    assert_false(w->disk[0].has[3]);
    assert_int_equal(open_holds(w), 0);
    w->node[3].hold[w->node[3].n_holds++] = lost; // found again, too late
    member_holds(w, 3);
    world_run(w, 2);
    finish(w);
    world_close(w);
}

/* The disk of a board comes late: its part is not lost after all. */
static void test_part_that_comes_back(void **state)
{
    (void)state;
    struct world *w = cut_world(11);
    w->node[3].n_holds = 0;
    member_holds(w, 3);
    plug_in(w, 3);
    assert_int_equal(w->told, 1);
    w->node[3].n_holds = 1;
    member_holds(w, 3);
    world_run(w, 20);
    assert_int_equal(w->joints, 1);
    assert_string_equal(w->last, "");
    assert_true(w->disk[0].has[3]);
    finish(w);
    world_close(w);
}

static void test_board_that_is_gone_for_good(void **state)
{
    (void)state;
    struct world *w = cut_world(11);
    char text[TAKE_TEXT];
    assert_true(conductor_parts_choice(&w->leader, &w->leader.take[0], text));
    assert_non_null(strstr(text, "board-03: is away; 3 of 4 parts are there"));
    assert_int_equal(accept(w, "0123abcd-000101"), OK);
    world_run(w, 5);
    assert_int_equal(w->joints, 1);
    assert_int_equal(w->told, 1);
    assert_string_equal(w->last, "board-03: is away");
    assert_int_equal(open_holds(w), 1);
    plug_in(w, 3);
    finish(w);
    world_close(w);

    w = cut_world(12); // nothing is there
    for (int k = 0; k < 3; k++)
        cut_link(w, k, 200);
    kill_node(w, LEADER, 5);
    world_run(w, 60);
    assert_int_equal(accept(w, "0123abcd-000101"), ERR_LOST);
    assert_non_null(strstr(err_text(), "no board that is there has a part of it"));
    world_run(w, 200);
    assert_int_equal(open_holds(w), 4); // those that are back wait for the last one
    plug_in(w, 3);
    assert_int_equal(w->joints, 1);
    finish(w);
    world_close(w);
}

static void test_partial_take(void **state)
{
    (void)state;
    struct world *w = ready_world(4, 5);
    w->set.bracket_mode = CONFIG_LIST;
    w->set.bracket_middle_us = 10000;
    w->set.rig_partial = 1;
    assert_true(world_press(w));
    world_run(w, 0.3);
    kill_node(w, 1, 500);
    world_run(w, 60);
    assert_int_equal(w->joints, 1);
    assert_non_null(strstr(w->last, "board-01"));
    assert_true(world_press(w)); // without it
    world_run(w, 60);
    assert_int_equal(w->joints, 2);
    finish(w);
    world_close(w);
}

/* A member whose link breaks after it stored its part delivers it an hour later. */
static void test_late_delivery(void **state)
{
    (void)state;
    struct world *w = ready_world(4, 11);
    w->set.bracket_mode = CONFIG_LIST;
    w->set.bracket_middle_us = 10000;
    assert_true(world_press(w));
    world_run(w, 0.6);
    cut_link(w, 3, 3600);
    world_run(w, 1800);
    assert_int_equal(w->joints, 0);
    assert_int_equal(open_takes(w), 1);
    assert_int_equal(open_holds(w), 4);
    kill_node(w, LEADER, 10);
    world_run(w, 1900);
    assert_int_equal(w->joints, 1);
    finish(w);
    world_close(w);
}

static void test_broker_away_for_an_hour(void **state)
{
    (void)state;
    struct world *w = ready_world(4, 12);
    assert_true(world_press(w));
    world_run(w, 2.5);
    stop_broker(w, 3600);
    world_run(w, 1800);
    refused(w, "broker is not reached");
    world_run(w, 1900);
    finish(w);
    assert_true(world_press(w));
    world_run(w, 20);
    assert_true(w->joints >= 1);
    finish(w);
    world_close(w);
}

static void test_skewed_takes_are_shot_again(void **state)
{
    (void)state;
    struct world *w = ready_world(8, 13);
    w->set.bracket_skew_ms = 100;
    w->faults.late = 0.1;
    int tries = 0;
    for (int i = 0; i < 40; i++) {
        assert_true(world_press(w));
        world_run(w, 60);
    }
    for (int i = 0; i < w->n_disk; i++)
        tries++;
    assert_true(tries > 45);
    assert_true(w->joints >= 25);
    assert_int_equal(w->told, 40);
    assert_non_null(strstr(w->last, "")); // each with a sentence: tell_outcome
    finish(w);
    world_close(w);
}

static struct message_conductor presence(const char *epoch, bool online)
{
    struct message_conductor c = {.online = online, .board = "second", .version = "1"};
    snprintf(c.epoch, sizeof c.epoch, "%s", epoch);
    return c;
}

/* The one that started first goes on. */
static void test_two_conductors(void **state)
{
    (void)state;
    struct world *w = ready_world(2, 14);
    struct message_conductor younger = presence("ffffffffffffffff", true);
    struct message_conductor older = presence("0000000000000000", true);
    struct conductor_event ev = {.kind = CONDUCTOR_OTHER, .conductor = &younger};
    assert_int_equal(leader_event(w, ev), OK);
    assert_int_equal(w->leader.state, CONDUCTOR_LEADS);
    ev.conductor = &older;
    assert_int_equal(leader_event(w, ev), OK);
    refused(w, "second leads this rig");
    older.online = false;
    assert_int_equal(leader_event(w, ev), OK);
    world_run(w, 5);
    assert_int_equal(w->leader.state, CONDUCTOR_LEADS);
    world_close(w);
}

static void test_takes_that_are_given_up(void **state)
{
    (void)state;
    struct world *w = ready_world(3, 15);
    w->set.bracket_mode = CONFIG_LIST;
    w->set.bracket_middle_us = 10000;
    for (int i = 0; i < 2; i++) {
        assert_true(world_press(w));
        world_run(w, 0.6);
        cut_link(w, 1, 100000);
        world_run(w, 60);
        w->node[1].linked = true;
        break;
    }
    assert_int_equal(open_takes(w), 1);
    struct conductor_event ev = {.kind = CONDUCTOR_FORGET, .take = "nothing"};
    assert_int_equal(leader_event(w, ev), ERR_ARG);
    ev.take = "0123abcd-000101";
    assert_int_equal(leader_event(w, ev), OK);
    assert_non_null(strstr(w->last, "given up"));
    finish(w);
    world_close(w);
}

struct soak {
    uint64_t seed;
    int members, presses;
    struct faults faults;
    bool partial;
    int skew_ms;
};

static void soak(const struct soak *s, long *presses, long *kills)
{
    struct world *w = ready_world(s->members, s->seed);
    w->faults = s->faults;
    w->set.rig_partial = s->partial;
    w->set.bracket_skew_ms = s->skew_ms;
    long begun = 0;
    for (int guard = 0; begun < s->presses; guard++) {
        assert_true(guard < 200 * s->presses);
        begun += world_press(w);
        world_run(w, 1 + 8 * chance(w));
        owner_decides(w, 0.3);
    }
    finish(w);
    assert_int_equal(w->told + w->lost, begun);
    printf("%d members, seed %d: %ld takes begun, %ld joined, %ld accepted, %ld outcomes told, %ld "
           "lost with the conductor, %ld kills, %ld cuts\n",
           s->members, (int)s->seed, begun, w->joints, w->accepts, w->told, w->lost, w->kills,
           w->cuts);
    assert_true(w->joints > begun / 3);
    *presses += begun;
    *kills += w->kills;
    world_close(w);
}

static void test_faults(void **state)
{
    const struct faults some = {0.02, 0.02, 0.1, 0.0005, 0.0005, 0.0005, true, 0};
    const struct faults many = {0.02, 0.02, 0.3, 0.006, 0.002, 0.002, true, 0.002};
    const struct soak soaks[] = {
        {1, 16, 600, some, false, 0}, {2, 16, 500, some, false, 100},
        {3, 4, 500, many, false, 0},  {4, 16, 300, some, true, 100},
        {5, 4, 300, many, true, 0},   {6, 2, 300, many, false, 100},
        {7, 100, 30, some, true, 0},
    };
    long presses = 0, kills = 0;
    (void)state;
    for (size_t i = 0; i < sizeof soaks / sizeof soaks[0]; i++)
        soak(&soaks[i], &presses, &kills);
    printf("%ld takes, %ld power cuts\n", presses, kills);
    assert_true(presses >= 2000 && kills >= 300);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_orders_that_are_not_followed),
        cmocka_unit_test(test_orders_that_come_again),
        cmocka_unit_test(test_press_becomes_a_take),
        cmocka_unit_test(test_presses_that_are_refused),
        cmocka_unit_test(test_boards_that_meter),
        cmocka_unit_test(test_member_dies_while_it_shoots),
        cmocka_unit_test(test_lost_part_waits_for_the_owner),
        cmocka_unit_test(test_board_that_falls_silent),
        cmocka_unit_test(test_part_that_comes_back),
        cmocka_unit_test(test_board_that_is_gone_for_good),
        cmocka_unit_test(test_partial_take),
        cmocka_unit_test(test_late_delivery),
        cmocka_unit_test(test_broker_away_for_an_hour),
        cmocka_unit_test(test_skewed_takes_are_shot_again),
        cmocka_unit_test(test_two_conductors),
        cmocka_unit_test(test_takes_that_are_given_up),
        cmocka_unit_test(test_faults),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
