/* SPDX-License-Identifier: Apache-2.0
 *
 * An emulated device with the C interface of OpenHaptics' HDAPI, for tests: a servo thread at the
 * scheduler's rate calls back, and between hdBeginFrame and hdEndFrame the device is read and its
 * torques are set. The device is that of pneu's hand lab, behind a socket whose path is the name of
 * the device. Numbers are those of hdDefines.h; the text is our own.
 */
#include <errno.h>
#include <pthread.h>
#include <stdint.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

typedef unsigned int HHD;
typedef unsigned int HDenum;
typedef unsigned int HDCallbackCode;
typedef struct { unsigned int code; int internal; HHD device; } HDErrorInfo;
typedef HDCallbackCode (*HDSchedulerCallback)(void *);

enum { ENCODERS = 0x2010, JOINT_TORQUE = 0x2703, FORCE_OUTPUT = 0x4000 };
enum { INVALID_ENUM = 0x0100, INVALID_VALUE = 0x0101, BAD_HANDLE = 0x0104, DEVICE_FAULT = 0x0300,
       COMM_ERROR = 0x0302, ILLEGAL_BEGIN = 0x0400 };

#pragma pack(push, 1)
typedef struct { int64_t time_ns; int32_t counts[3]; uint32_t wrong; } Frame;
typedef struct { uint32_t number; double torque[3]; } Torques;
#pragma pack(pop)

static int link_fd = -1, running, in_frame, enabled;
static unsigned long rate = 1000;
static pthread_t servo;
static HDSchedulerCallback callback;
static void *user;
static Frame frame;
static Torques torques;
static HDErrorInfo errors[8];
static int first_error, error_count;

static void fail(unsigned int code, int internal) {
    if (error_count < 8) {
        HDErrorInfo e = {code, internal, 1};
        errors[(first_error + error_count++) % 8] = e;
    }
}

HHD hdInitDevice(const char *name) {
    struct sockaddr_un where = {.sun_family = AF_UNIX};
    if (!name) { fail(DEVICE_FAULT, 0); return 0xFFFFFFFFu; }
    strncpy(where.sun_path, name, sizeof(where.sun_path) - 1);
    link_fd = socket(AF_UNIX, SOCK_SEQPACKET | SOCK_NONBLOCK, 0);
    if (connect(link_fd, (struct sockaddr *)&where, sizeof(where)) < 0) {
        fail(DEVICE_FAULT, errno);
        close(link_fd);
        link_fd = -1;
        return 0xFFFFFFFFu;
    }
    memset(&torques, 0, sizeof(torques));
    return 1;
}

void hdMakeCurrentDevice(HHD h) { if (h != 1) fail(BAD_HANDLE, 0); }
void hdEnable(HDenum what) { if (what == FORCE_OUTPUT) enabled = 1; else fail(INVALID_ENUM, 0); }
void hdDisable(HDenum what) { if (what == FORCE_OUTPUT) enabled = 0; }

void hdDisableDevice(HHD h) {
    (void)h;
    if (link_fd >= 0) close(link_fd);
    link_fd = -1;
}

void hdSetSchedulerRate(unsigned long r) {
    if (r < 500 || r > 4000) fail(INVALID_VALUE, 0); else rate = r;
}

static void *serve(void *nothing) {
    struct timespec next;
    (void)nothing;
    clock_gettime(CLOCK_MONOTONIC, &next);
    while (running) {
        if (callback && callback(user) == 0) callback = 0;
        next.tv_nsec += 1000000000L / (long)rate;
        if (next.tv_nsec >= 1000000000L) { next.tv_nsec -= 1000000000L; next.tv_sec++; }
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, 0);
    }
    return 0;
}

unsigned long hdScheduleAsynchronous(HDSchedulerCallback c, void *data, unsigned short priority) {
    (void)priority;
    user = data;
    callback = c;
    return 1;
}

void hdUnschedule(unsigned long handle) { (void)handle; callback = 0; }
void hdStartScheduler(void) { running = 1; pthread_create(&servo, 0, serve, 0); }

void hdStopScheduler(void) {
    if (!running) return;
    running = 0;
    if (!pthread_equal(pthread_self(), servo)) pthread_join(servo, 0);
}

void hdBeginFrame(HHD h) {
    Frame newest;
    ssize_t got;
    if (h != 1 || in_frame) { fail(ILLEGAL_BEGIN, 0); return; }
    in_frame = 1;
    while ((got = recv(link_fd, &newest, sizeof(newest), 0)) == (ssize_t)sizeof(newest)) frame = newest;
    if (got == 0 || (got < 0 && errno != EAGAIN && errno != EWOULDBLOCK)) fail(COMM_ERROR, errno);
    if (frame.wrong) fail(DEVICE_FAULT, (int)frame.wrong);
}

void hdEndFrame(HHD h) {
    (void)h;
    in_frame = 0;
    torques.number++;
    if (!enabled) memset(torques.torque, 0, sizeof(torques.torque));
    if (send(link_fd, &torques, sizeof(torques), MSG_NOSIGNAL) < 0 && errno != EAGAIN)
        fail(COMM_ERROR, errno);
}

void hdGetLongv(HDenum what, long *values) {
    if (what != ENCODERS) { fail(INVALID_ENUM, 0); return; }
    for (int k = 0; k < 6; k++) values[k] = k < 3 ? frame.counts[k] : 0;
}

void hdSetDoublev(HDenum what, const double *values) {
    if (what != JOINT_TORQUE) { fail(INVALID_ENUM, 0); return; }
    for (int k = 0; k < 3; k++) torques.torque[k] = 1e-3 * values[k]; /* given in mN m */
}

HDErrorInfo hdGetError(void) {
    HDErrorInfo none = {0, 0, 0};
    if (!error_count) return none;
    none = errors[first_error];
    first_error = (first_error + 1) % 8;
    error_count--;
    return none;
}

const char *hdGetErrorString(unsigned int code) {
    switch (code) {
    case COMM_ERROR: return "communication error";
    case DEVICE_FAULT: return "device fault";
    case INVALID_VALUE: return "invalid value";
    default: return "error";
    }
}
