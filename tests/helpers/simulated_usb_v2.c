/* libusb 1.0 with two simulated Kinects v2, as far as libfreenect2 calls it; loaded before it. The phases that they
 * measure are those of a sphere around the camera with a nearer rectangle. Each stream keeps real time. */
#define _GNU_SOURCE
#include <libusb-1.0/libusb.h>
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { KINECTS = 2, QUEUE = 256, HANDLES = 16, PACKET = 0x8400 };
enum { WIDTH = 512, HEIGHT = 424, SUBIMAGE = WIDTH * HEIGHT * 11 / 8, SUBIMAGES = 10, PARTS = 9, FRAME = PARTS * SUBIMAGES, P0_TABLES = 1302572, COLOR_TABLES = 12981 };
typedef struct { uint32_t magic[2], timestamp, sequence, subsequence, length, fields[32]; } footer_t;
struct libusb_device { int kinect, address, references; struct libusb_context *context; };
struct libusb_device_handle {
    struct libusb_device device; uint32_t command[6]; int replied, count, cancelling, claims; unsigned long sent;
    struct libusb_transfer *waiting[QUEUE];
};

/* What a test sets and reads. */
int usb_gone[KINECTS], usb_forbidden[KINECTS], usb_busy[KINECTS], usb_replugged[KINECTS], usb_submissions = -1;
int usb_handles, usb_claims, usb_transfers, usb_contexts, usb_fps = 30;
uint32_t usb_first_ticks = 1000;
float usb_lens[] = {365.0f, 366.0f, 0.0f, 300.5f, 205.5f, 0.09f, -0.27f, 0.001f, 0.002f, 0.08f};  /* fx fy ? cx cy k1 k2 p1 p2 k3 */
static struct libusb_device_handle *handles[HANDLES];
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static uint8_t images[SUBIMAGES][SUBIMAGE];

/* Packets that a sensor sent since this library was loaded. All sensors send frames together. */
static unsigned long sent_by_now(void)
{
    static double begun;
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    double now = t.tv_sec + 1e-9 * t.tv_nsec;
    if (!begun) begun = now;
    return (now - begun) * usb_fps * FRAME;
}

/* The code of 11 bits for a measurement: pieces of twice the step, then the sign. */
static int code_of(double value)
{
    int best = 0, size = 0;
    for (int code = 0; code < 1024 && size <= fabs(value); code++) {
        best = code;
        size += 1 << (code / 128 - (code >= 128));
    }
    return value < 0 ? 1024 + (best ? best : 1) : best;
}
__attribute__((constructor)) static void draw(void)
{
    static const double UNITS[] = {3.0, 15.0, 2.0};  /* a period of each frequency; both ways together: 1250 mm a unit */
    int codes[2][9];
    for (int near = 0; near < 2; near++)
        for (int k = 0; k < 9; k++)
            codes[near][k] = code_of(300.0 * cos(2 * M_PI * ((near ? 3.0 : 4.0) / UNITS[k / 3] + k % 3 / 3.0)));
    for (int k = 0; k < 9; k++)
        for (int row = 0; row < HEIGHT; row++)
            for (int x = 1; x < WIDTH - 1; x++) {
                int shown = HEIGHT - 1 - row, near = x >= 100 && x < 200 && shown >= 50 && shown < 150;
                int bit = ((x >> 2) + ((x & 3) << 7)) * 11 + 5632 * (row < 212 ? row + 212 : 423 - row);
                for (int i = 0; i < 11; i++, bit++)
                    if (codes[near][k] >> i & 1) images[k][bit / 8] |= 1 << bit % 8;
            }
}

const struct libusb_version *libusb_get_version(void)
{
    static const struct libusb_version version = {1, 0, 26, 11724, "", ""};
    return &version;
}
int libusb_init(libusb_context **context) { *context = malloc(1); __sync_add_and_fetch(&usb_contexts, 1); return 0; }
void libusb_exit(libusb_context *context) { free(context); __sync_sub_and_fetch(&usb_contexts, 1); }

ssize_t libusb_get_device_list(libusb_context *context, libusb_device ***list)
{
    int count = 0;
    *list = calloc(KINECTS + 1, sizeof **list);
    for (int i = 0; i < KINECTS; i++) {
        if (usb_gone[i]) continue;
        *((*list)[count++] = malloc(sizeof(libusb_device))) = (libusb_device){i, 5 + i + KINECTS * usb_replugged[i], 1, context};
    }
    return count;
}
libusb_device *libusb_ref_device(libusb_device *device) { device->references++; return device; }
void libusb_unref_device(libusb_device *device) { if (--device->references == 0) free(device); }
void libusb_free_device_list(libusb_device **list, int unref)
{
    for (int i = 0; unref && list[i]; i++) libusb_unref_device(list[i]);
    free(list);
}
uint8_t libusb_get_bus_number(libusb_device *device) { return 1 + device->kinect; }
uint8_t libusb_get_device_address(libusb_device *device) { return device->address; }
int libusb_get_device_descriptor(libusb_device *device, struct libusb_device_descriptor *found)
{
    memset(found, 0, sizeof *found);
    found->idVendor = 0x045e;
    found->idProduct = device->kinect ? 0x02c4 : 0x02d8;
    found->iSerialNumber = 3;
    return 0;
}
int libusb_get_string_descriptor_ascii(libusb_device_handle *handle, uint8_t index, unsigned char *text, int length)
{
    return index == 3 ? snprintf((char *)text, length, "01234567%d", handle->device.kinect) : LIBUSB_ERROR_INVALID_PARAM;
}
static int gone(libusb_device_handle *handle)
{
    return usb_gone[handle->device.kinect] || handle->device.address != 5 + handle->device.kinect + KINECTS * usb_replugged[handle->device.kinect];
}
int libusb_open(libusb_device *device, libusb_device_handle **handle)
{
    if (usb_gone[device->kinect]) return LIBUSB_ERROR_NO_DEVICE;
    if (usb_forbidden[device->kinect]) return LIBUSB_ERROR_ACCESS;
    *handle = calloc(1, sizeof **handle);
    (*handle)->device = *device;
    pthread_mutex_lock(&lock);
    for (int i = 0; i < HANDLES; i++)
        if (!handles[i]) { handles[i] = *handle; break; }
    usb_handles++;
    pthread_mutex_unlock(&lock);
    return 0;
}
void libusb_close(libusb_device_handle *handle)
{
    pthread_mutex_lock(&lock);
    for (int i = 0; i < HANDLES; i++)
        if (handles[i] == handle) handles[i] = NULL;
    usb_handles--;
    usb_claims -= handle->claims;  /* the system releases what is still claimed */
    pthread_mutex_unlock(&lock);
    free(handle);
}
libusb_device *libusb_get_device(libusb_device_handle *handle) { return &handle->device; }
int libusb_reset_device(libusb_device_handle *handle) { return gone(handle) ? LIBUSB_ERROR_NO_DEVICE : 0; }
int libusb_get_configuration(libusb_device_handle *handle, int *value) { *value = 1; return gone(handle) ? LIBUSB_ERROR_NO_DEVICE : 0; }
int libusb_set_configuration(libusb_device_handle *handle, int value) { return handle && value == 1 ? 0 : LIBUSB_ERROR_NOT_FOUND; }
int libusb_claim_interface(libusb_device_handle *handle, int interface)
{
    if (usb_busy[handle->device.kinect]) return LIBUSB_ERROR_BUSY;
    handle->claims++;
    __sync_add_and_fetch(&usb_claims, 1);
    return interface < 2 ? 0 : LIBUSB_ERROR_NOT_FOUND;
}
int libusb_release_interface(libusb_device_handle *handle, int interface)
{
    handle->claims--;
    __sync_sub_and_fetch(&usb_claims, 1);
    return gone(handle) || interface > 1 ? LIBUSB_ERROR_NO_DEVICE : 0;
}
int libusb_set_interface_alt_setting(libusb_device_handle *handle, int interface, int setting)
{
    (void)setting;
    return gone(handle) ? LIBUSB_ERROR_NO_DEVICE : interface == 1 ? 0 : LIBUSB_ERROR_NOT_FOUND;
}
static const struct libusb_endpoint_descriptor endpoint = {.bEndpointAddress = 0x84, .bmAttributes = LIBUSB_TRANSFER_TYPE_ISOCHRONOUS};
static const struct libusb_interface_descriptor settings[] = {{0}, {.bNumEndpoints = 1, .endpoint = &endpoint}};
static const struct libusb_interface interfaces[] = {{settings, 1}, {settings, 2}};
static struct libusb_config_descriptor configuration = {.bNumInterfaces = 2, .interface = interfaces};
int libusb_get_config_descriptor_by_value(libusb_device *device, uint8_t value, struct libusb_config_descriptor **found)
{
    *found = &configuration;
    return device && value == 1 ? 0 : LIBUSB_ERROR_NOT_FOUND;
}
void libusb_free_config_descriptor(struct libusb_config_descriptor *descriptor) { (void)descriptor; }
int libusb_get_ss_endpoint_companion_descriptor(libusb_context *context, const struct libusb_endpoint_descriptor *of, struct libusb_ss_endpoint_companion_descriptor **found)
{
    static struct libusb_ss_endpoint_companion_descriptor companion = {.wBytesPerInterval = PACKET};
    (void)context;
    *found = &companion;
    return of == &endpoint ? 0 : LIBUSB_ERROR_NOT_FOUND;
}
void libusb_free_ss_endpoint_companion_descriptor(struct libusb_ss_endpoint_companion_descriptor *companion) { (void)companion; }
const char *libusb_error_name(int code)
{
    return code == LIBUSB_ERROR_ACCESS ? "LIBUSB_ERROR_ACCESS" : code == LIBUSB_ERROR_BUSY ? "LIBUSB_ERROR_BUSY"
        : code == LIBUSB_ERROR_NO_DEVICE ? "LIBUSB_ERROR_NO_DEVICE" : code == LIBUSB_ERROR_NO_MEM ? "LIBUSB_ERROR_NO_MEM" : "error";
}
const char *libusb_strerror(int code) { return code ? "as simulated" : "success"; }
int libusb_control_transfer(libusb_device_handle *handle, uint8_t type, uint8_t request, uint16_t value, uint16_t index, unsigned char *data, uint16_t length, unsigned timeout)
{
    (void)type; (void)request; (void)value; (void)index; (void)data; (void)timeout;
    return gone(handle) ? LIBUSB_ERROR_NO_DEVICE : length;
}

/* Commands: magic, number, longest reply, command, 0, parameters. After a reply with data comes one that says so. */
int libusb_bulk_transfer(libusb_device_handle *handle, unsigned char to, unsigned char *data, int length, int *transferred, unsigned timeout)
{
    (void)timeout;
    if (gone(handle)) return LIBUSB_ERROR_NO_DEVICE;
    *transferred = length;
    if (to == 0x02) {
        memset(handle->command, 0, sizeof handle->command);
        memcpy(handle->command, data, length < (int)sizeof handle->command ? length : (int)sizeof handle->command);
        handle->replied = handle->command[2] == 0;
        return 0;
    }
    if (handle->replied) {
        uint32_t complete[4] = {0x0a6fe000, handle->command[1]};
        memcpy(data, complete, sizeof complete);
        return 0;
    }
    handle->replied = 1;
    memset(data, 0, length);
    if (handle->command[3] == 0x16) data[0] = 1;  /* ready */
    if (handle->command[3] != 0x22) return 0;
    if (handle->command[5] == 1) {
        char serial[16];
        int letters = snprintf(serial, sizeof serial, "01234567%d", handle->device.kinect);
        for (int i = 0; i < letters; i++) data[2 * i] = serial[i];
    }
    if (handle->command[5] == 2) *transferred = P0_TABLES;
    if (handle->command[5] == 3) memcpy(data, usb_lens, sizeof usb_lens), *transferred = 92;
    if (handle->command[5] == 4) *transferred = COLOR_TABLES;
    return 0;
}

struct libusb_transfer *libusb_alloc_transfer(int packets)
{
    __sync_add_and_fetch(&usb_transfers, 1);
    return calloc(1, sizeof(struct libusb_transfer) + packets * sizeof(struct libusb_iso_packet_descriptor));
}
void libusb_free_transfer(struct libusb_transfer *transfer) { free(transfer); __sync_sub_and_fetch(&usb_transfers, 1); }
int libusb_submit_transfer(struct libusb_transfer *transfer)
{
    libusb_device_handle *handle = transfer->dev_handle;
    if (gone(handle)) return LIBUSB_ERROR_NO_DEVICE;
    if (usb_submissions == 0) return LIBUSB_ERROR_NO_MEM;
    if (usb_submissions > 0) usb_submissions--;
    pthread_mutex_lock(&lock);
    if (!handle->sent) handle->sent = (sent_by_now() / FRAME + 1) * FRAME;
    handle->waiting[handle->count++] = transfer;
    pthread_mutex_unlock(&lock);
    return 0;
}
int libusb_cancel_transfer(struct libusb_transfer *transfer)
{
    libusb_device_handle *handle = transfer->dev_handle;
    int found = LIBUSB_ERROR_NOT_FOUND;
    pthread_mutex_lock(&lock);
    for (int i = 0; i < handle->count; i++)
        if (handle->waiting[i] == transfer) handle->cancelling = 1, found = 0;
    pthread_mutex_unlock(&lock);
    return found;
}

static void fill(libusb_device_handle *handle, struct libusb_transfer *transfer)
{
    unsigned char *to = transfer->buffer;
    for (int i = 0; i < transfer->num_iso_packets; i++, to += PACKET) {
        unsigned long part = handle->sent % PARTS, sub = handle->sent / PARTS % SUBIMAGES, frame = handle->sent++ / FRAME;
        int length = part == PARTS - 1 ? SUBIMAGE - part * PACKET : PACKET;
        memcpy(to, images[sub] + part * PACKET, length);
        if (part == PARTS - 1) {
            footer_t footer = {.timestamp = usb_first_ticks + frame * 8000 / usb_fps, .sequence = 1 + frame, .subsequence = sub, .length = SUBIMAGE};
            memcpy(to + length, &footer, sizeof footer);
            length += sizeof footer;
        }
        transfer->iso_packet_desc[i].actual_length = length;
        transfer->iso_packet_desc[i].status = LIBUSB_TRANSFER_COMPLETED;
    }
}
/* The next transfer that is over, if one is. */
static struct libusb_transfer *over(libusb_device_handle *handle)
{
    if (!handle->count) return NULL;
    struct libusb_transfer *first = handle->waiting[0];
    if (!gone(handle) && !handle->cancelling && handle->sent + first->num_iso_packets > sent_by_now()) return NULL;
    memmove(handle->waiting, handle->waiting + 1, --handle->count * sizeof first);
    first->status = gone(handle) ? LIBUSB_TRANSFER_NO_DEVICE : handle->cancelling ? LIBUSB_TRANSFER_CANCELLED : LIBUSB_TRANSFER_COMPLETED;
    for (int i = 0; i < first->num_iso_packets; i++) first->iso_packet_desc[i].status = LIBUSB_TRANSFER_ERROR;
    if (first->status == LIBUSB_TRANSFER_COMPLETED) fill(handle, first);
    return first;
}
int libusb_handle_events_timeout_completed(libusb_context *context, struct timeval *timeout, int *completed)
{
    (void)timeout; (void)completed;
    usleep(1000);
    for (int h = 0; h < HANDLES; h++)
        for (int n = 0; n < QUEUE; n++) {
            pthread_mutex_lock(&lock);
            libusb_device_handle *handle = handles[h];
            struct libusb_transfer *done = handle && handle->device.context == context ? over(handle) : NULL;
            pthread_mutex_unlock(&lock);
            if (!done) break;
            done->callback(done);
        }
    return 0;
}
