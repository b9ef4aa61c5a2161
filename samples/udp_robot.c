/* A robot, or a joystick, in C: the controller's end of the protocol of docs/wire-formats.md.

       cc -O2 -std=c11 -Wall -Wextra -o udp_robot udp_robot.c
       ./udp_robot robot 9000 &
       ./udp_robot joystick 9001 &
       kontur-av stream --setup taskboard --robot udp:127.0.0.1:9000 --joystick udp:127.0.0.1:9001

   The robot is a mass of 1 kg before a wall. The joystick is in a hand that moves it in a circle
   and lets go of its dead-man button every eight seconds. With a key file as third argument they
   answer other machines, too. To drive hardware, replace `advance`, `measure` and the facts.

   What follows the key file, or -, are axes behind x and y, in the setup's order:

       ./udp_robot robot 9000 - z yaw gripper &
       ./udp_robot joystick 9001 - z yaw gripper &
*/
#define _POSIX_C_SOURCE 200809L
#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <poll.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { VERSION = 1, PLANE = 2, MOST = 7, KEY = 32, NONCE = 16, CODE = 16, HEAD = 4, LONGEST = 400 };
enum { HELLO = 1, WELCOME = 2, COMMAND = 3, READING = 4 };
enum { ROBOT = 1, JOYSTICK = 2 };
enum { POWER = 1, ACTIVE = 2 };                     /* of a robot: the states wanted; 0 is off */
enum { CALIBRATED = 2, APPLICATION = 3 };           /* of a joystick: two of its states */
enum { CONTACT = 1, DEAD_MAN = 2 };                 /* what a reading's detail can say */
#define SILENCE_NS 50000000                         /* who hears nothing for so long stops */
#ifndef MEASURES
#define MEASURES 1                                  /* 0: the robot measures no force */
#endif
#define LIMIT_N 25.0                                /* the robot's largest force on an axis */

/* SHA-256 (FIPS 180-4) and HMAC (RFC 2104) of keys with 32 octets. */

static uint32_t turned(uint32_t x, int by) { return x >> by | x << (32 - by); }

static void sha256_block(uint32_t state[8], const uint8_t block[64])
{
    static const uint32_t k[64] = {
        0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4,
        0xab1c5ed5, 0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe,
        0x9bdc06a7, 0xc19bf174, 0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f,
        0x4a7484aa, 0x5cb0a9dc, 0x76f988da, 0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7,
        0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967, 0x27b70a85, 0x2e1b2138, 0x4d2c6dfc,
        0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85, 0xa2bfe8a1, 0xa81a664b,
        0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070, 0x19a4c116,
        0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
        0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7,
        0xc67178f2};
    uint32_t w[64], s[8];
    for (int i = 0; i < 16; i++)
        w[i] = (uint32_t)block[4 * i] << 24 | (uint32_t)block[4 * i + 1] << 16 |
               (uint32_t)block[4 * i + 2] << 8 | block[4 * i + 3];
    for (int i = 16; i < 64; i++) {
        uint32_t a = w[i - 15], b = w[i - 2];
        w[i] = w[i - 16] + w[i - 7] + (turned(a, 7) ^ turned(a, 18) ^ a >> 3) +
               (turned(b, 17) ^ turned(b, 19) ^ b >> 10);
    }
    memcpy(s, state, sizeof s);
    for (int i = 0; i < 64; i++) {
        uint32_t one = s[7] + (turned(s[4], 6) ^ turned(s[4], 11) ^ turned(s[4], 25)) +
                       ((s[4] & s[5]) ^ (~s[4] & s[6])) + k[i] + w[i];
        uint32_t two = (turned(s[0], 2) ^ turned(s[0], 13) ^ turned(s[0], 22)) +
                       ((s[0] & s[1]) ^ (s[0] & s[2]) ^ (s[1] & s[2]));
        memmove(s + 1, s, 7 * sizeof *s);
        s[4] += one;
        s[0] = one + two;
    }
    for (int i = 0; i < 8; i++) state[i] += s[i];
}

/* The hash of at most 64 octets, a whole first block, and `size` octets, at most LONGEST. */
static void sha256(uint8_t out[32], const uint8_t first[64], const uint8_t *data, size_t size)
{
    uint32_t state[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                         0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};
    uint8_t rest[LONGEST + 72] = {0};
    size_t blocks = (size + 9 + 63) / 64, bits = 8 * (64 + size);
    memcpy(rest, data, size);
    rest[size] = 0x80;
    for (int i = 0; i < 4; i++) rest[64 * blocks - 1 - i] = (uint8_t)(bits >> 8 * i);
    sha256_block(state, first);
    for (size_t i = 0; i < blocks; i++) sha256_block(state, rest + 64 * i);
    for (int i = 0; i < 32; i++) out[i] = (uint8_t)(state[i / 4] >> (24 - 8 * (i % 4)));
}

static void hmac(uint8_t out[32], const uint8_t key[KEY], const uint8_t *data, size_t size)
{
    uint8_t inner[64], outer[64], hash[32];
    memset(inner, 0x36, sizeof inner);
    memset(outer, 0x5c, sizeof outer);
    for (int i = 0; i < KEY; i++) inner[i] ^= key[i], outer[i] ^= key[i];
    sha256(hash, inner, data, size);
    sha256(out, outer, hash, sizeof hash);
}

/* Datagrams: numbers are big-endian, fractions IEEE 754 binary32. */

static uint8_t *put(uint8_t *at, uint64_t value, int octets)
{
    for (int i = 0; i < octets; i++) at[i] = (uint8_t)(value >> 8 * (octets - 1 - i));
    return at + octets;
}

static uint8_t *put_float(uint8_t *at, double value)
{
    float single = (float)value;
    uint32_t bits;
    memcpy(&bits, &single, sizeof bits);
    return put(at, bits, 4);
}

static uint64_t got(const uint8_t *at, int octets)
{
    uint64_t value = 0;
    for (int i = 0; i < octets; i++) value = value << 8 | at[i];
    return value;
}

static double got_float(const uint8_t *at)
{
    uint32_t bits = (uint32_t)got(at, 4);
    float single;
    memcpy(&single, &bits, sizeof single);
    return single;
}

static int is_authentic(const uint8_t *datagram, size_t size, const uint8_t key[KEY])
{
    uint8_t code[32], wrong = 0;
    hmac(code, key, datagram, size - CODE);
    for (int i = 0; i < CODE; i++) wrong |= code[i] ^ datagram[size - CODE + i];
    return !wrong;
}

/* The device. */

/* What it can have behind x and y: half its range, force, speed (m, N; rad, N m), and its kind. */
static const struct axis { const char *name; double half, force, speed; int kind; } known[] = {
    {"z", 0.10, 12.0, 0.5, 1},     {"roll", 1.0, 0.8, 3.0, 2}, {"pitch", 1.0, 0.8, 3.0, 2},
    {"yaw", 1.0, 0.8, 3.0, 2},     {"gripper", 0.04, 12.0, 0.3, 1},
};
static const struct axis *more[MOST];  /* of x and y: 0 */
static int axes = PLANE;

static int role;
static int state;                      /* as the newest command wants it; 0 after a silence */
static double force[MOST];             /* as the newest command orders it, N */
static double place[MOST], speed[MOST];
static int pressed;                    /* the dead-man button */

static double wall(void)
{
    const double wall_m = 0.06, stiffness_n_m = 600.0;
    return role == ROBOT && place[0] > wall_m ? stiffness_n_m * (wall_m - place[0]) : 0.0;
}

/* The device moves on by dt seconds, at most a millisecond. */
static void advance(double dt)
{
    const double mass_kg = 1.0, friction_n_s_m = 2.0, brake_n_s_m = 100.0;
    const double radius_m = 0.045, turn_rad_s = 1.571, held_s = 8.0, free_s = 0.5;
    static double since_s, cosine = 1.0, sine;
    if (role == ROBOT) {
        /* One that is not active has no force, and brakes. */
        double friction = state == ACTIVE ? friction_n_s_m : brake_n_s_m;
        for (int i = 0; i < axes; i++) {
            /* A rotation is a mass at a lever of 0.1 m. */
            double inertia = mass_kg * (more[i] && more[i]->kind == 2 ? 0.01 : 1.0);
            double push = (state == ACTIVE ? force[i] : 0.0) + (i ? 0.0 : wall());
            push -= friction * speed[i] * inertia;
            speed[i] += push / inertia * dt;
            place[i] += speed[i] * dt;
        }
    } else if (role == JOYSTICK && state == APPLICATION) {
        since_s = since_s < free_s + held_s ? since_s + dt : 0.0;
        pressed = since_s >= free_s;
        if (!pressed) cosine = 1.0, sine = 0.0;
        double turn = pressed ? turn_rad_s : 0.0;
        sine += cosine * turn * dt;
        cosine -= sine * turn * dt;
        place[0] = radius_m * (1.0 - cosine), place[1] = radius_m * sine;
        speed[0] = radius_m * turn * sine, speed[1] = radius_m * turn * cosine;
        for (int i = PLANE; i < axes; i++) {
            place[i] = 0.5 * more[i]->half * sine;
            speed[i] = 0.5 * more[i]->half * turn * cosine;
        }
    } else {
        /* The hand lets go, and the stick springs back to its middle. */
        since_s = sine = 0.0, cosine = 1.0, pressed = 0;
        for (int i = 0; i < axes; i++) speed[i] = place[i] = 0.0;
    }
}

static uint8_t *put_facts(uint8_t *at)
{
    const char *name = role == ROBOT ? "a mass in C" : "a circling hand in C";
    at = put_float(at, role == ROBOT ? LIMIT_N : 0.0); /* largest force; 0: no motors */
    at = put_float(at, role == ROBOT ? 0.5 : 0.0);  /* largest speed of a robot, m/s */
    at = put_float(at, 0.0);                        /* of a joystick with motors: mass, */
    at = put_float(at, 0.0);                        /* Coulomb friction, */
    at = put_float(at, 0.0);                        /* and viscous friction */
    at = put(at, role == ROBOT && !MEASURES, 1);    /* buttons; of a robot 1: it measures no force */
    at = put(at, 0, 1);                             /* LEDs */
    at = put_float(at, role == ROBOT ? 0.15 : 0.12); /* half the workspace along x, m */
    at = put_float(at, role == ROBOT ? 0.10 : 0.08); /* and along y */
    for (int i = PLANE; i < axes; i++) {
        at = put_float(put_float(put_float(at, more[i]->half), more[i]->force), more[i]->speed);
        at = put(at, (uint64_t)more[i]->kind, 1);
        memset(at, 0, 11); /* its name, padded with zeros */
        memcpy(at, more[i]->name, strlen(more[i]->name));
        at += 11;
    }
    memcpy(at, name, strlen(name));
    return at + strlen(name);
}

/* A session begins with a hello, but counts only once a command has come with its key. */

struct session {
    uint8_t commands[KEY], readings[KEY];
    uint64_t newest, sent;
};

static uint8_t key[KEY];
static struct session now, next;
static int64_t heard_ns;

static int64_t clock_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static size_t sealed(uint8_t *datagram, uint8_t *end, const uint8_t by[KEY])
{
    uint8_t code[32];
    hmac(code, by, datagram, (size_t)(end - datagram));
    memcpy(end, code, CODE);
    return (size_t)(end - datagram) + CODE;
}

static uint8_t *put_head(uint8_t *at, int kind, int detail)
{
    return put(put(put(put(at, VERSION, 1), (uint64_t)kind, 1), (uint64_t)axes, 1), (uint64_t)detail, 1);
}

/* Answer a hello with a nonce of our own, which makes the session's keys. */
static size_t welcome(uint8_t *out, const uint8_t *hello)
{
    uint8_t own[NONCE], text[7 + 2 * NONCE] = "command";
    int random = open("/dev/urandom", O_RDONLY | O_CLOEXEC);
    if (random < 0 || read(random, own, NONCE) != NONCE) exit(1);
    close(random);
    memcpy(text + 7, hello + HEAD, NONCE);
    memcpy(text + 7 + NONCE, own, NONCE);
    memset(&next, 0, sizeof next);
    hmac(next.commands, key, text, sizeof text);
    memcpy(text, "reading", 7);
    hmac(next.readings, key, text, sizeof text);
    uint8_t *end = put_head(out, WELCOME, 0); /* 0: a robot that takes forces */
    memcpy(end, text + 7, 2 * NONCE);
    return sealed(out, put_facts(end + 2 * NONCE), key);
}

static size_t measure(uint8_t *out)
{
    int contact = wall() < 0.0 ? CONTACT : 0;
    uint8_t *end = put_head(out, READING, role == ROBOT ? contact : pressed ? DEAD_MAN : 0);
    end = put(put(end, ++now.sent, 8), now.newest, 8);
    end = put(put(end, 0, 2), 0, 2);            /* no button pressed, no error, so no text */
    end = put(end, 0x7fc00000, 4);              /* not a number: no thermometer */
    for (int i = 0; i < axes; i++)
        end = put_float(put_float(put_float(end, place[i]), speed[i]), i || !MEASURES ? 0.0 : wall());
    return sealed(out, end, now.readings);
}

/* Take a datagram; return how many octets the answer has, 0 for none. */
static size_t answer(uint8_t *out, const uint8_t *in, size_t size)
{
    const size_t hello = HEAD + NONCE + CODE, command = HEAD + 12 + 12 * (size_t)axes + CODE;
    if (size < HEAD || in[0] != VERSION || in[2] != (in[1] == HELLO ? PLANE : axes)) return 0;
    if (in[1] == HELLO && size == hello && in[3] == role && is_authentic(in, size, key))
        return welcome(out, in);
    if (in[1] != COMMAND || size != command) return 0;
    uint64_t number = got(in + HEAD, 8);
    if (is_authentic(in, size, now.commands)) {
        if (number <= now.newest) return 0;
    } else {
        if (!is_authentic(in, size, next.commands) || !number) return 0;
        now = next;
    }
    now.newest = number;
    heard_ns = clock_ns();
    state = in[3];
    for (int i = 0; i < axes; i++) {
        double limit = more[i] ? more[i]->force : LIMIT_N;
        double wanted = got_float(in + HEAD + 12 + 12 * i);
        /* Whatever it is told, it exerts no more than it can, and nothing that is no number. */
        force[i] = !(wanted >= -limit) ? wanted < 0.0 ? -limit : 0.0
                   : wanted > limit    ? limit
                                       : wanted;
    }
    return measure(out);
}

static void read_key(const char *path)
{
    FILE *file = fopen(path, "r");
    struct stat about;
    unsigned octet;
    if (!file || fstat(fileno(file), &about) || about.st_mode & 077) {
        fprintf(stderr, "%s must be a file that only its owner may read\n", path);
        exit(2);
    }
    for (int i = 0; i < KEY; i++) {
        if (fscanf(file, "%2x", &octet) != 1) {
            fprintf(stderr, "%s has no %d digits of hexadecimal\n", path, 2 * KEY);
            exit(2);
        }
        key[i] = (uint8_t)octet;
    }
    fclose(file);
}

int main(int count, char **words)
{
    for (int word = 4; word < count; word++)
        for (size_t i = 0; i < sizeof known / sizeof *known && axes < MOST; i++)
            if (!strcmp(words[word], known[i].name)) more[axes++] = &known[i];
    if (count < 3 || axes - PLANE != (count > 4 ? count - 4 : 0) || (strcmp(words[1], "robot") && strcmp(words[1], "joystick"))) {
        fprintf(stderr, "usage: %s robot|joystick PORT [KEYFILE|- [z|roll|pitch|yaw|gripper ...]]\n", words[0]);
        return 2;
    }
    role = strcmp(words[1], "robot") ? JOYSTICK : ROBOT;
    int keyed = count > 3 && strcmp(words[3], "-");
    if (keyed) read_key(words[3]);
    struct sockaddr_in own = {.sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(words[2]))};
    own.sin_addr.s_addr = htonl(keyed ? INADDR_ANY : INADDR_LOOPBACK);
    int udp = socket(AF_INET, SOCK_DGRAM, 0);
    if (udp < 0 || bind(udp, (struct sockaddr *)&own, sizeof own)) {
        perror(words[2]);
        return 1;
    }
    /* Without a session its keys must not be zeros, which everybody knows. */
    int random = open("/dev/urandom", O_RDONLY | O_CLOEXEC);
    if (random < 0 || read(random, &now, sizeof now) != (ssize_t)sizeof now) return 1;
    close(random);
    next = now;
    /* As the session's own loops; without the right to it, the system may be late. */
    if (sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){.sched_priority = 20}))
        perror("no real-time priority, so it may be late");
    int64_t at_ns = clock_ns();
    for (;;) {
        uint8_t in[LONGEST + 1], out[LONGEST];
        struct sockaddr_in from;
        socklen_t length = sizeof from;
        struct pollfd waits = {.fd = udp, .events = POLLIN};
        poll(&waits, 1, 1);
        int64_t until_ns = clock_ns();
        if (until_ns - heard_ns > SILENCE_NS) state = 0;
        for (; at_ns < until_ns; at_ns += 1000000)
            advance((until_ns - at_ns < 1000000 ? until_ns - at_ns : 1000000) * 1e-9);
        at_ns = until_ns;
        ssize_t size = recvfrom(udp, in, sizeof in, MSG_DONTWAIT, (struct sockaddr *)&from, &length);
        if (size <= 0 || size > LONGEST) continue;
        size_t octets = answer(out, in, (size_t)size);
        if (octets) sendto(udp, out, octets, 0, (struct sockaddr *)&from, length);
    }
}
