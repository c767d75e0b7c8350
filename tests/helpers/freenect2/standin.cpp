// A stand-in for libfreenect2 with two Kinects v2, as strict as libfreenect2.cpp: what it refuses, what it logs, and
// which memory it uses again. The names of what a test sets are those of simulated_usb_v2.c.
#include <libfreenect2/libfreenect2.hpp>

#include <cstdlib>
#include <cstring>
#include <limits>
#include <mutex>
#include <vector>

enum { KINECTS = 2, WIDTH = 512, HEIGHT = 424 };
extern "C" {
int usb_gone[KINECTS], usb_forbidden[KINECTS], usb_busy[KINECTS], usb_replugged[KINECTS], usb_submissions = -1, usb_handles;
int usb_computing[KINECTS];  // whether depth of a packet is computed while the sensor is closed
float usb_lens[] = {365.0f, 366.0f, 0.0f, 300.5f, 205.5f, 0.09f, -0.27f, 0.001f, 0.002f, 0.08f};
}

namespace libfreenect2 {
static Logger *logger;
static std::recursive_mutex lock;

void setGlobalLogger(Logger *used) {
  delete logger;
  logger = used;
}
static void say(Logger::Level level, const std::string &message) {
  if (logger) logger->log(level, message);
}
static std::string place(int kinect) { return "@" + std::to_string(1 + kinect) + ":" + std::to_string(5 + kinect + KINECTS * usb_replugged[kinect]); }
static std::string serial_of(int kinect) { return "01234567" + std::to_string(kinect); }

struct Device : Freenect2Device {
  enum State { Open, Streaming, Closed } state = Open;
  int kinect, replugged;
  const PacketPipeline *pipeline;
  IrCameraParams lens;
  static std::vector<Device *> all;

  Device(int kinect, const PacketPipeline *pipeline) : kinect(kinect), replugged(usb_replugged[kinect]), pipeline(pipeline) {
    float unknown = std::numeric_limits<float>::quiet_NaN();  // read when the streams start
    lens = {unknown, unknown, unknown, unknown, unknown, unknown, unknown, unknown, unknown};
    all.push_back(this);
    usb_handles++;
  }
  ~Device() override {
    close();
    if (usb_computing[kinect]) give(Frame::Depth, 0, 0, 1, std::vector<float>(WIDTH * HEIGHT).data());
    delete pipeline;
    std::lock_guard<std::recursive_mutex> guard(lock);
    for (size_t i = 0; i < all.size(); i++)
      if (all[i] == this) all.erase(all.begin() + i);
  }
  static Device *of(int kinect) {
    for (Device *one : all)
      if (one->kinect == kinect && one->state != Closed && one->replugged == usb_replugged[kinect]) return one;
    return nullptr;
  }
  bool gone() const { return usb_gone[kinect] || replugged != usb_replugged[kinect]; }

  IrCameraParams getIrCameraParams() override { return lens; }
  void setIrAndDepthFrameListener(FrameListener *used) override { pipeline->getDepthPacketProcessor()->listener = used; }
  bool startStreams(bool, bool depth) override {
    if (state != Open) return false;
    if (gone()) {
      say(Logger::Error, "[protocol::UsbControl] failed to set video transfer function state! LIBUSB_ERROR_NO_DEVICE as simulated");
      return false;
    }
    const float *at = usb_lens;
    lens = {at[0], at[1], at[3], at[4], at[5], at[6], at[9], at[7], at[8]};
    if (usb_submissions >= 0 && usb_submissions < 60) say(Logger::Error, "[usb::TransferPool] failed to submit transfer: LIBUSB_ERROR_NO_MEM as simulated");
    if (usb_submissions == 0) return false;
    state = Streaming;
    return depth;
  }
  bool close() override {
    std::lock_guard<std::recursive_mutex> guard(lock);
    if (state == Closed) return true;
    state = Closed;
    if (pipeline->getDepthPacketProcessor()) pipeline->getDepthPacketProcessor()->listener = nullptr;
    usb_handles--;
    return true;
  }
  // A frame that the listener did not take is used again.
  bool give(Frame::Type type, uint32_t sequence, uint32_t ticks, uint32_t status, const float *pixels) {
    std::vector<float> memory(pixels, pixels + WIDTH * HEIGHT);
    Frame frame = {WIDTH, HEIGHT, 4, reinterpret_cast<unsigned char *>(memory.data()), ticks, sequence, 0, 0, 0, status, Frame::Float};
    bool taken = pipeline->processor.listener->onNewFrame(type, &frame);
    std::memset(memory.data(), 0xff, memory.size() * sizeof(float));
    return taken;
  }
};
std::vector<Device *> Device::all;
static std::vector<int> enumerated;

OpenGLPacketPipeline::OpenGLPacketPipeline() {
  if (std::getenv("DISPLAY")) return;
  say(Logger::Error, "[OpenGLDepthPacketProcessor] Failed to initialize GLFW.");
  exit(-1);
}

DepthPacketProcessor *PacketPipeline::getDepthPacketProcessor() const { return &processor; }

Freenect2::Freenect2(void *) {}

int Freenect2::enumerateDevices() {
  std::lock_guard<std::recursive_mutex> guard(lock);
  enumerated.clear();
  for (int kinect = 0; kinect < KINECTS; kinect++) {
    if (usb_gone[kinect]) continue;
    if (!Device::of(kinect) && usb_forbidden[kinect])
      say(Logger::Error, "[Freenect2Impl] failed to open Kinect v2: " + place(kinect) + " LIBUSB_ERROR_ACCESS as simulated");
    else
      enumerated.push_back(kinect);
  }
  say(Logger::Info, "[Freenect2Impl] found " + std::to_string(enumerated.size()) + " devices");
  return enumerated.size();
}

std::string Freenect2::getDeviceSerialNumber(int index) {
  return index < 0 || index >= (int)enumerated.size() ? std::string() : serial_of(enumerated[index]);
}

Freenect2Device *Freenect2::openDevice(const std::string &serial, const PacketPipeline *pipeline) {
  std::lock_guard<std::recursive_mutex> guard(lock);
  for (int kinect : enumerated) {
    if (serial_of(kinect) != serial) continue;
    if (Device *open = Device::of(kinect)) {
      say(Logger::Warning, "[Freenect2Impl] device " + place(kinect) + " is already be open!");
      delete pipeline;
      return open;
    }
    if (usb_busy[kinect]) {
      say(Logger::Error, "[protocol::UsbControl] failed to claim interface with ControlAndRgbInterfaceId(=0)! LIBUSB_ERROR_BUSY as simulated. Try debugging with environment variable: export LIBUSB_DEBUG=3 .");
      say(Logger::Error, "[Freenect2Impl] failed to open Kinect v2: " + place(kinect));
      delete pipeline;
      return nullptr;
    }
    return new Device(kinect, pipeline);
  }
  delete pipeline;
  return nullptr;  // and it logs nothing
}
}  // namespace libfreenect2

// Gives a running sensor's listener a frame, on this thread; returns whether one is running, or -1 if the listener would
// free the frame.
extern "C" int standin_frame(int kinect, int type, uint32_t sequence, uint32_t ticks, uint32_t status, const float *pixels) {
  using namespace libfreenect2;
  std::lock_guard<std::recursive_mutex> guard(lock);
  Device *device = Device::of(kinect);
  if (!device || device->gone() || device->state != Device::Streaming || !device->pipeline->processor.listener) return 0;
  return device->give(static_cast<Frame::Type>(type), sequence, ticks, status, pixels) ? -1 : 1;
}
