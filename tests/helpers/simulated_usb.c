/* libusb 1.0 with two simulated Kinects v1 (model 1414), as far as libfreenect 0.5 calls it; loaded before it.
 * A frame's depth is the raw value 900 with a rectangle of 800, its colour is red. Each stream keeps real time. */
#define _GNU_SOURCE
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

enum { KINECTS = 2, PACKETS = 16, STREAMS = 2, QUEUE = 64, HEAD = 12, FPS = 30 };
enum { COMPLETED = 0, CANCELLED = 3, NO_DEVICE = 5, ERROR_NO_DEVICE = -4, ERROR_NOT_FOUND = -5 };
static const int FRAME_BYTES[STREAMS] = {640 * 480 * 11 / 8, 640 * 480}, PACKET_BYTES[STREAMS] = {1748, 1908};
static const int FLAG[STREAMS] = {0x70, 0x80}, ENDPOINT[STREAMS] = {0x82, 0x81};

typedef struct { unsigned length, actual_length; int status; } packet_t;
typedef struct transfer {
    void *handle; uint8_t flags; unsigned char endpoint, type; unsigned timeout; int status, length, actual_length;
    void (*callback)(struct transfer *); void *user_data; unsigned char *buffer; int packets; packet_t packet[];
} transfer_t;
typedef struct { uint8_t length, type; uint16_t usb; uint8_t class[4]; uint16_t vendor, product, device; uint8_t maker, name, serial, configurations; } descriptor_t;
_Static_assert(sizeof(descriptor_t) == 18 && sizeof(transfer_t) == 64, "as in libusb.h");
typedef struct { int kinect; void *context; } device_t;
typedef struct { transfer_t *waiting[QUEUE]; int count, sent, cancelling; double begun; uint8_t seq; } stream_t;
typedef struct { device_t device; uint8_t reply[0x200]; int reply_length; stream_t stream[STREAMS]; } handle_t;

/* What a test sets and reads. */
int usb_gone[KINECTS], usb_handles, usb_claims, usb_transfers, usb_contexts;
uint32_t usb_first_ticks = 0;
static handle_t *handles[QUEUE];
static uint8_t *frames[STREAMS];

static double now(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return t.tv_sec + 1e-9 * t.tv_nsec; }

__attribute__((constructor)) static void draw(void)
{
    uint8_t *depth = frames[0] = calloc(1, FRAME_BYTES[0] + 2), *color = frames[1] = calloc(1, FRAME_BYTES[1]);
    for (int i = 0; i < 640 * 480; i++) {
        int x = i % 640, y = i / 640, raw = x >= 200 && x < 300 && y >= 100 && y < 200 ? 800 : 900;
        for (int bit = 0; bit < 11; bit++)  /* the most significant bit first */
            if (raw >> (10 - bit) & 1) depth[(i * 11 + bit) / 8] |= 0x80 >> (i * 11 + bit) % 8;
        color[i] = y % 2 == 0 && x % 2 == 1 ? 200 : 0;  /* the red pixels of the Bayer pattern */
    }
}

int libusb_init(void **context) { *context = malloc(1); __sync_add_and_fetch(&usb_contexts, 1); return 0; }
void libusb_exit(void *context) { free(context); __sync_sub_and_fetch(&usb_contexts, 1); }

long libusb_get_device_list(void *context, device_t ***list)
{
    int count = 0;
    *list = calloc(KINECTS + 1, sizeof **list);
    for (int i = 0; i < KINECTS; i++) {
        if (usb_gone[i]) continue;
        *((*list)[count++] = malloc(sizeof(device_t))) = (device_t){i, context};
    }
    return count;
}
void libusb_free_device_list(device_t **list, int unref)
{
    for (int i = 0; unref && list[i]; i++) free(list[i]);
    free(list);
}
int libusb_get_device_descriptor(device_t *device, descriptor_t *found)
{
    *found = (descriptor_t){18, 1, 0x200, {0}, 0x045e, 0x02ae, 267, 2, 1, 3, 1};
    return device ? 0 : -1;
}
int libusb_get_string_descriptor_ascii(handle_t *handle, uint8_t index, unsigned char *text, int length)
{
    return index == 3 ? snprintf((char *)text, length, "A0036%d", handle->device.kinect) : -1;
}
int libusb_open(device_t *device, handle_t **handle)
{
    if (usb_gone[device->kinect]) return ERROR_NO_DEVICE;
    *handle = calloc(1, sizeof **handle);
    (*handle)->device = *device;
    for (int i = 0; i < QUEUE; i++)
        if (__sync_bool_compare_and_swap(&handles[i], NULL, *handle)) break;
    __sync_add_and_fetch(&usb_handles, 1);
    return 0;
}
void libusb_close(handle_t *handle)
{
    for (int i = 0; i < QUEUE; i++) __sync_bool_compare_and_swap(&handles[i], handle, NULL);
    free(handle);
    __sync_sub_and_fetch(&usb_handles, 1);
}
device_t *libusb_get_device(handle_t *handle) { return &handle->device; }
int libusb_kernel_driver_active(handle_t *handle, int interface) { return handle && interface; }
int libusb_detach_kernel_driver(handle_t *handle, int interface) { return handle && interface; }
int libusb_attach_kernel_driver(handle_t *handle, int interface) { return handle && interface; }
int libusb_claim_interface(handle_t *handle, int interface) { __sync_add_and_fetch(&usb_claims, 1); return handle && interface; }
int libusb_release_interface(handle_t *handle, int interface) { __sync_sub_and_fetch(&usb_claims, 1); return handle && interface; }
int libusb_get_max_iso_packet_size(device_t *device, unsigned char endpoint) { return device && endpoint ? 1920 : -1; }
const char *libusb_error_name(int code) { return code ? "error" : "success"; }

/* Commands to the camera: 47 4d, length in words, command, tag; replies: 52 42 and the same. */
int libusb_control_transfer(handle_t *handle, uint8_t type, uint8_t request, uint16_t value, uint16_t index,
                            unsigned char *data, uint16_t length, unsigned timeout)
{
    (void)request; (void)value; (void)index; (void)timeout;
    if (usb_gone[handle->device.kinect]) return ERROR_NO_DEVICE;
    if (type == 0xc0) { memcpy(data, handle->reply, handle->reply_length); return handle->reply_length; }
    uint16_t words[4 + 4] = {0}, parameter;
    memcpy(words, data, length < sizeof words ? length : sizeof words);
    parameter = words[4];
    uint8_t *reply = handle->reply + 8;
    memset(handle->reply, 0, sizeof handle->reply);
    int size = 2;
    if (words[2] == 0x16) size = parameter == 0x41 ? 8 : parameter == 0x40 ? 118 : 4;
    if (words[2] == 0x16 && parameter == 0) reply[2] = 200;  /* the constant shift */
    if (words[2] == 0x04) {
        float plane[4] = {7.5f, 2.3f, 120.0f, 0.1042f};
        memcpy(reply + 94, plane, sizeof plane);
        size = 322;
    }
    uint16_t head[4] = {0x4252, size / 2, words[2], words[3]};
    memcpy(handle->reply, head, sizeof head);
    handle->reply_length = size + 8;
    return length;
}

transfer_t *libusb_alloc_transfer(int packets)
{
    __sync_add_and_fetch(&usb_transfers, 1);
    return calloc(1, sizeof(transfer_t) + packets * sizeof(packet_t));
}
void libusb_free_transfer(transfer_t *transfer) { free(transfer); __sync_sub_and_fetch(&usb_transfers, 1); }
static stream_t *stream_of(transfer_t *transfer)
{
    return &((handle_t *)transfer->handle)->stream[transfer->endpoint == ENDPOINT[0] ? 0 : 1];
}
int libusb_submit_transfer(transfer_t *transfer)
{
    if (usb_gone[((handle_t *)transfer->handle)->device.kinect]) return ERROR_NO_DEVICE;
    stream_t *stream = stream_of(transfer);
    if (!stream->begun) stream->begun = now();
    stream->waiting[stream->count++] = transfer;
    return 0;
}
int libusb_cancel_transfer(transfer_t *transfer)
{
    stream_t *stream = stream_of(transfer);
    for (int i = 0; i < stream->count; i++)
        if (stream->waiting[i] == transfer) { stream->cancelling = 1; return 0; }
    return ERROR_NOT_FOUND;
}

static void finish(stream_t *stream, int status)
{
    transfer_t *transfer = stream->waiting[0];
    memmove(stream->waiting, stream->waiting + 1, --stream->count * sizeof *stream->waiting);
    transfer->status = status;
    transfer->callback(transfer);
}
static void fill(int kind, stream_t *stream, transfer_t *transfer)
{
    int each = PACKET_BYTES[kind], total = (FRAME_BYTES[kind] + each - 1) / each;
    unsigned char *to = transfer->buffer;
    for (int i = 0; i < transfer->packets; i++, to += transfer->packet[i].length) {
        int frame = stream->sent / total, number = stream->sent++ % total, left = FRAME_BYTES[kind] - number * each;
        uint32_t ticks = usb_first_ticks + 2000000u * frame + (kind ? 300000u : 0);
        uint8_t head[HEAD] = {'R', 'B', 0, FLAG[kind] | (number == 0 ? 1 : number == total - 1 ? 5 : 2), 0, stream->seq++};
        memcpy(head + 8, &ticks, 4);
        memcpy(to, head, HEAD);
        memcpy(to + HEAD, frames[kind] + number * each, left < each ? left : each);
        transfer->packet[i].actual_length = HEAD + (left < each ? left : each);
    }
}
int libusb_handle_events_timeout(void *context, struct timeval *timeout)
{
    (void)timeout;
    usleep(1000);
    for (int h = 0; h < QUEUE; h++) {
        handle_t *handle = handles[h];
        for (int kind = 0; handle && kind < STREAMS; kind++) {
            stream_t *stream = &handle->stream[kind];
            if (!stream->count || handle->device.context != context) continue;
            int total = (FRAME_BYTES[kind] + PACKET_BYTES[kind] - 1) / PACKET_BYTES[kind];
            if (usb_gone[handle->device.kinect]) while (stream->count) finish(stream, NO_DEVICE);
            else if (stream->cancelling) while (stream->count) finish(stream, CANCELLED);
            else for (int n = 0; n < 8 && stream->sent < (now() - stream->begun) * FPS * total; n++) {
                fill(kind, stream, stream->waiting[0]);
                finish(stream, COMPLETED);
            }
        }
    }
    return 0;
}
int libusb_handle_events(void *context) { return libusb_handle_events_timeout(context, NULL); }
