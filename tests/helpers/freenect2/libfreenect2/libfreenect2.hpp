// Declarations of libfreenect2 that binding.cpp uses, for the stand-in; names and types are those of its headers.
#pragma once
#include <cstddef>
#include <cstdint>
#include <string>

namespace libfreenect2 {
struct Frame {
  enum Type { Color = 1, Ir = 2, Depth = 4 };
  enum Format { Invalid = 0, Raw = 1, Float = 2 };
  size_t width, height, bytes_per_pixel;
  unsigned char *data;
  uint32_t timestamp, sequence;
  float exposure, gain, gamma;
  uint32_t status;
  Format format;
};

struct FrameListener {
  virtual ~FrameListener() {}
  virtual bool onNewFrame(Frame::Type type, Frame *frame) = 0;
};

struct Freenect2Device {
  struct IrCameraParams { float fx, fy, cx, cy, k1, k2, k3, p1, p2; };
  virtual ~Freenect2Device() {}
  virtual IrCameraParams getIrCameraParams() = 0;
  virtual void setIrAndDepthFrameListener(FrameListener *listener) = 0;
  virtual bool startStreams(bool rgb, bool depth) = 0;
  virtual bool close() = 0;
};

struct DepthPacketProcessor {
  FrameListener *listener = nullptr;
};

#define LIBFREENECT2_WITH_OPENGL_SUPPORT
struct PacketPipeline {
  virtual ~PacketPipeline() {}
  virtual DepthPacketProcessor *getDepthPacketProcessor() const;
  mutable DepthPacketProcessor processor;
};
struct CpuPacketPipeline : PacketPipeline {};
struct OpenGLPacketPipeline : PacketPipeline {
  OpenGLPacketPipeline();
};

struct Freenect2 {
  Freenect2(void *usb_context = 0);
  int enumerateDevices();
  std::string getDeviceSerialNumber(int index);
  Freenect2Device *openDevice(const std::string &serial, const PacketPipeline *pipeline);
};

class Logger {
 public:
  enum Level { None = 0, Error = 1, Warning = 2, Info = 3, Debug = 4 };
  virtual ~Logger() {}
  virtual void log(Level level, const std::string &message) = 0;

 protected:
  Level level_;
};
void setGlobalLogger(Logger *logger);
}  // namespace libfreenect2
