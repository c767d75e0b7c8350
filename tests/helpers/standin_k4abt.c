/* A stand-in for libk4a and libk4abt: their prototypes and struct sizes, known joints, faults on demand.
 * It checks what the real library would crash on: every handle is one of its own and still alive. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define EXPORT __attribute__((visibility("default")))
enum { SUCCEEDED = 0, FAILED = 1, TIMEOUT = 2 };
enum { JOINTS = 32, QUEUE = 3, CALIBRATION_SIZE = 1032 };

typedef struct { int sensor_orientation; int processing_mode; int32_t gpu_device_id; const char *model_path; } configuration_t;
typedef struct { float position[3]; float orientation[4]; int confidence; } joint_t;
typedef struct { joint_t joints[JOINTS]; } skeleton_t;
typedef struct { uint32_t id; skeleton_t skeleton; } body_t;
_Static_assert(sizeof(configuration_t) == 24, "configuration");
_Static_assert(sizeof(joint_t) == 32, "joint");
_Static_assert(sizeof(body_t) == 1028, "body");

typedef struct { uint32_t magic; int references; int format, width, height; uint64_t usec; uint8_t *data; } image_t;
typedef struct { uint32_t magic; int references; image_t *depth, *ir; } capture_t;
typedef struct { uint32_t magic; uint64_t waiting[QUEUE]; uint16_t corner[QUEUE]; int64_t due[QUEUE]; int64_t busy_until; int count; } tracker_t;
typedef struct { uint32_t magic; uint64_t usec; uint16_t corner; uint32_t bodies; } frame_t;
enum { IMAGE = 0x1111, CAPTURE = 0x2222, TRACKER = 0x3333, FRAME = 0x4444, DEAD = 0x5555 };

/* What the test asks for, and what it reads back. */
EXPORT int standin_create_status, standin_enqueue_status, standin_pop_status, standin_calibration_status;
EXPORT uint32_t standin_bodies = 1, standin_first_id = 7;
EXPORT int standin_alive, standin_misuses;
EXPORT int standin_processing, standin_orientation;
EXPORT int32_t standin_wait_ms;
EXPORT int32_t standin_tracking_ms; /* how long the tracker works on a frame, on a thread of its own */
EXPORT uint32_t standin_firmware[3] = {1, 6, 110};
EXPORT float standin_smoothing = -1.0f;

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}
static void wait_until(int64_t ns) {
    struct timespec until = {ns / 1000000000LL, ns % 1000000000LL};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL)) {}
}
static void *born(size_t size, uint32_t magic) {
    uint32_t *thing = calloc(1, size);
    *thing = magic;
    __atomic_add_fetch(&standin_alive, 1, __ATOMIC_SEQ_CST); /* two sensors' threads work at once */
    return thing;
}
static int is(const void *thing, uint32_t magic) {
    if (thing && *(const uint32_t *)thing == magic) return 1;
    __atomic_add_fetch(&standin_misuses, 1, __ATOMIC_SEQ_CST);
    return 0;
}
static void dies(void *thing) {
    *(uint32_t *)thing = DEAD;
    __atomic_sub_fetch(&standin_alive, 1, __ATOMIC_SEQ_CST);
    free(thing);
}

/* k4a_hardware_version_t: four versions of three numbers, build, signature. */
EXPORT int k4a_device_get_version(const void *device, uint32_t *version) {
    if (!device) return FAILED;
    memset(version, 0, 56);
    memcpy(version, standin_firmware, sizeof standin_firmware);
    return SUCCEEDED;
}
EXPORT int k4a_calibration_get_from_raw(char *raw, size_t size, int depth_mode, int color_mode, uint8_t *calibration) {
    if (standin_calibration_status || size == 0 || raw[size - 1] != 0 || color_mode != 0) return FAILED;
    memset(calibration, 0, CALIBRATION_SIZE);
    memcpy(calibration + CALIBRATION_SIZE - 8, &depth_mode, 4);
    return SUCCEEDED;
}
EXPORT int k4a_image_create(int format, int width, int height, int stride, image_t **out) {
    image_t *image = born(sizeof *image, IMAGE);
    image->references = 1; image->format = format; image->width = width; image->height = height;
    image->data = malloc((size_t)stride * height);
    *out = image;
    return SUCCEEDED;
}
EXPORT uint8_t *k4a_image_get_buffer(image_t *image) { return is(image, IMAGE) ? image->data : NULL; }
EXPORT void k4a_image_set_device_timestamp_usec(image_t *image, uint64_t usec) { if (is(image, IMAGE)) image->usec = usec; }
EXPORT void k4a_image_release(image_t *image) {
    if (is(image, IMAGE) && --image->references == 0) { free(image->data); dies(image); }
}
EXPORT int k4a_capture_create(capture_t **out) {
    capture_t *capture = born(sizeof *capture, CAPTURE);
    capture->references = 1;
    *out = capture;
    return SUCCEEDED;
}
EXPORT void k4a_capture_set_depth_image(capture_t *capture, image_t *image) {
    if (is(capture, CAPTURE) && is(image, IMAGE) && image->format == 4) { capture->depth = image; image->references++; }
}
EXPORT void k4a_capture_set_ir_image(capture_t *capture, image_t *image) {
    if (is(capture, CAPTURE) && is(image, IMAGE) && image->format == 5) { capture->ir = image; image->references++; }
}
EXPORT void k4a_capture_release(capture_t *capture) {
    if (!is(capture, CAPTURE) || --capture->references) return;
    if (capture->depth) k4a_image_release(capture->depth);
    if (capture->ir) k4a_image_release(capture->ir);
    dies(capture);
}

EXPORT int k4abt_tracker_create(const uint8_t *calibration, configuration_t configuration, tracker_t **out) {
    int depth_mode;
    memcpy(&depth_mode, calibration + CALIBRATION_SIZE - 8, 4);
    *out = NULL;
    if (standin_create_status) return standin_create_status;
    if (depth_mode != 2 && depth_mode != 3) return FAILED;
    standin_processing = configuration.processing_mode;
    standin_orientation = configuration.sensor_orientation;
    *out = born(sizeof **out, TRACKER);
    return SUCCEEDED;
}
EXPORT void k4abt_tracker_set_temporal_smoothing(tracker_t *tracker, float smoothing) {
    if (is(tracker, TRACKER)) standin_smoothing = smoothing;
}
EXPORT void k4abt_tracker_shutdown(tracker_t *tracker) { is(tracker, TRACKER); }
EXPORT void k4abt_tracker_destroy(tracker_t *tracker) { if (is(tracker, TRACKER)) dies(tracker); }

EXPORT int k4abt_tracker_enqueue_capture(tracker_t *tracker, capture_t *capture, int32_t timeout_ms) {
    standin_wait_ms = timeout_ms;
    if (!is(tracker, TRACKER) || !is(capture, CAPTURE)) return FAILED;
    if (standin_enqueue_status) return standin_enqueue_status;
    if (!capture->depth || !capture->ir) return FAILED;
    if (tracker->count == QUEUE) return TIMEOUT;
    tracker->corner[tracker->count] = *(uint16_t *)capture->depth->data;
    int64_t begun = now_ns();
    if (tracker->busy_until > begun) begun = tracker->busy_until;
    tracker->busy_until = tracker->due[tracker->count] = begun + standin_tracking_ms * 1000000LL;
    tracker->waiting[tracker->count++] = capture->depth->usec;
    return SUCCEEDED;
}
EXPORT int k4abt_tracker_pop_result(tracker_t *tracker, frame_t **out, int32_t timeout_ms) {
    standin_wait_ms = timeout_ms;
    *out = NULL;
    if (!is(tracker, TRACKER)) return FAILED;
    if (standin_pop_status) return standin_pop_status;
    if (tracker->count == 0) return TIMEOUT;
    if (standin_tracking_ms) {
        int64_t until = now_ns() + timeout_ms * 1000000LL;
        int in_time = tracker->due[0] <= until;
        wait_until(in_time ? tracker->due[0] : until);
        if (!in_time) return TIMEOUT;
    }
    frame_t *frame = born(sizeof *frame, FRAME);
    frame->usec = tracker->waiting[0];
    frame->corner = tracker->corner[0];
    frame->bodies = standin_bodies;
    tracker->count--;
    memmove(tracker->waiting, tracker->waiting + 1, sizeof tracker->waiting - sizeof *tracker->waiting);
    memmove(tracker->corner, tracker->corner + 1, sizeof tracker->corner - sizeof *tracker->corner);
    memmove(tracker->due, tracker->due + 1, sizeof tracker->due - sizeof *tracker->due);
    *out = frame;
    return SUCCEEDED;
}
EXPORT uint32_t k4abt_frame_get_num_bodies(frame_t *frame) { return is(frame, FRAME) ? frame->bodies : 0; }
EXPORT uint64_t k4abt_frame_get_device_timestamp_usec(frame_t *frame) { return is(frame, FRAME) ? frame->usec : 0; }
EXPORT uint32_t k4abt_frame_get_body_id(frame_t *frame, uint32_t index) {
    return is(frame, FRAME) && index < frame->bodies ? standin_first_id + index : 0xFFFFFFFF;
}
/* Joint j of body b: (1000 b + j, -10 j, the depth image's first pixel) mm, confidence j mod 4. */
EXPORT int k4abt_frame_get_body_skeleton(frame_t *frame, uint32_t index, skeleton_t *skeleton) {
    if (!is(frame, FRAME) || index >= frame->bodies) return FAILED;
    for (int j = 0; j < JOINTS; j++) {
        joint_t joint = {{1000.0f * index + j, -10.0f * j, frame->corner}, {1, 0, 0, 0}, j % 4};
        skeleton->joints[j] = joint;
    }
    return SUCCEEDED;
}
EXPORT void k4abt_frame_release(frame_t *frame) { if (is(frame, FRAME)) dies(frame); }
