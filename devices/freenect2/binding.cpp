// What library.py needs of libfreenect2, a C++ library, as C functions. It is compiled on the user's machine.
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <cstring>
#include <deque>
#include <mutex>
#include <string>
#include <vector>

#include <libfreenect2/libfreenect2.hpp>
#include <libfreenect2/logger.h>

#ifdef _WIN32
#define EXPORT extern "C" __declspec(dllexport)
#else
#define EXPORT extern "C" __attribute__((visibility("default")))
#endif

using libfreenect2::Frame;
using libfreenect2::Freenect2;
using libfreenect2::Freenect2Device;
using libfreenect2::Logger;
typedef std::chrono::steady_clock Clock;

static const size_t WIDTH = 512, HEIGHT = 424, LONGEST_LOG = 4000;
static const size_t QUEUE = 16;  // images that wait for the reader: half a second, more than a body tracker takes

// Errors that the library logged, a line each. They are never freed: its threads log until the process ends.
struct Errors {
  std::mutex mutex;
  std::string lines;
};
static Errors &errors() {
  static Errors *one = new Errors;
  return *one;
}

class ErrorLogger : public Logger {
 public:
  ErrorLogger() { level_ = Logger::Error; }
  void log(Level level, const std::string &message) override {
    if (level != Logger::Error) return;
    std::lock_guard<std::mutex> lock(errors().mutex);
    if (errors().lines.size() < LONGEST_LOG) errors().lines += message + "\n";
  }
};

struct Images {
  uint32_t ticks;
  Clock::time_point came;
  std::vector<float> depth, infrared;
};

// Keeps copies of the newest images. The library keeps its frames: some pipelines have two of them only.
class Listener : public libfreenect2::FrameListener {
 public:
  // Infrared comes first, then depth of the same packet.
  bool onNewFrame(Frame::Type type, Frame *frame) override {
    if (frame->status != 0 || frame->format != Frame::Float || frame->width != WIDTH || frame->height != HEIGHT) return false;
    const float *pixels = reinterpret_cast<const float *>(frame->data);
    std::vector<float> image(pixels, pixels + WIDTH * HEIGHT);
    if (type == Frame::Ir) {
      infrared_.swap(image);
      sequence_ = frame->sequence;
    } else if (type == Frame::Depth && !infrared_.empty() && frame->sequence == sequence_) {
      std::lock_guard<std::mutex> lock(mutex_);
      if (waiting_.size() == QUEUE) waiting_.pop_front();
      waiting_.push_back({frame->timestamp, Clock::now(), std::move(image), std::move(infrared_)});
      infrared_.clear();
      came_.notify_one();
    }
    return false;
  }

  bool take(int milliseconds, Images &oldest) {
    std::unique_lock<std::mutex> lock(mutex_);
    if (!came_.wait_for(lock, std::chrono::milliseconds(milliseconds), [this] { return !waiting_.empty(); })) return false;
    oldest = std::move(waiting_.front());
    waiting_.pop_front();
    return true;
  }

 private:
  std::vector<float> infrared_;
  uint32_t sequence_ = 0;
  std::mutex mutex_;
  std::condition_variable came_;
  std::deque<Images> waiting_;
};

struct Camera {
  Freenect2Device *device = nullptr;
  std::atomic<bool> closing{false};
  Listener listener;
};

// Closing a device takes the listener from the thread that computes depth, which may be about to call it. This pipeline
// hides that thread's processor then; the thread ends when the pipeline is deleted.
template <class Pipeline>
struct Kept : Pipeline {
  explicit Kept(const Camera &camera) : camera(camera) {}
  libfreenect2::DepthPacketProcessor *getDepthPacketProcessor() const override {
    return camera.closing ? nullptr : Pipeline::getDepthPacketProcessor();
  }
  const Camera &camera;
};

static libfreenect2::PacketPipeline *pipeline_of(const std::string &name, const Camera &camera) {
#ifdef LIBFREENECT2_WITH_OPENGL_SUPPORT
  if (name == "gl") return new Kept<libfreenect2::OpenGLPacketPipeline>(camera);
#endif
#ifdef LIBFREENECT2_WITH_CUDA_SUPPORT
  if (name == "cuda") return new Kept<libfreenect2::CudaPacketPipeline>(camera);
#endif
#ifdef LIBFREENECT2_WITH_OPENCL_SUPPORT
  if (name == "cl") return new Kept<libfreenect2::OpenCLPacketPipeline>(camera);
#endif
  return new Kept<libfreenect2::CpuPacketPipeline>(camera);
}

EXPORT Freenect2 *k2_context() {
  libfreenect2::setGlobalLogger(new ErrorLogger);
  return new Freenect2;
}

// The pipelines that compute depth, in the library's order of preference.
EXPORT const char *k2_pipelines() {
  return ""
#ifdef LIBFREENECT2_WITH_OPENGL_SUPPORT
         "gl "
#endif
#ifdef LIBFREENECT2_WITH_CUDA_SUPPORT
         "cuda "
#endif
#ifdef LIBFREENECT2_WITH_OPENCL_SUPPORT
         "cl "
#endif
         "cpu";
}

// Where OpenGL does not work, the library ends the process here.
EXPORT void k2_try_opengl() {
#ifdef LIBFREENECT2_WITH_OPENGL_SUPPORT
  delete new libfreenect2::OpenGLPacketPipeline;
#endif
}

// Looks for sensors; returns how many may be opened.
EXPORT int k2_count(Freenect2 *context) { return context->enumerateDevices(); }

// The text lives until this thread's next call.
EXPORT const char *k2_serial(Freenect2 *context, int index) {
  static thread_local std::string serial;
  serial = context->getDeviceSerialNumber(index);
  return serial.c_str();
}

// NULL if it does not open.
EXPORT Camera *k2_open(Freenect2 *context, const char *serial, const char *pipeline) {
  Camera *camera = new Camera;
  camera->device = context->openDevice(std::string(serial), pipeline_of(pipeline, *camera));
  if (camera->device == nullptr) {
    delete camera;
    return nullptr;
  }
  camera->device->setIrAndDepthFrameListener(&camera->listener);
  return camera;
}

// Starts depth and infrared, without colour; gives the lens, which the library reads now: fx fy cx cy k1 k2 p1 p2 k3.
EXPORT int k2_start(Camera *camera, float *lens) {
  if (!camera->device->startStreams(false, true)) return 0;
  const Freenect2Device::IrCameraParams at = camera->device->getIrCameraParams();
  const float values[] = {at.fx, at.fy, at.cx, at.cy, at.k1, at.k2, at.p1, at.p2, at.k3};
  std::memcpy(lens, values, sizeof values);
  return 1;
}

// The oldest images that wait, their time in ticks of the sensor's clock, and how long ago they came; 0 if none come.
EXPORT int k2_take(Camera *camera, int milliseconds, float *depth, float *infrared, uint32_t *ticks, int64_t *age_ns) {
  Images oldest;
  if (!camera->listener.take(milliseconds, oldest)) return 0;
  std::memcpy(depth, oldest.depth.data(), sizeof(float) * WIDTH * HEIGHT);
  std::memcpy(infrared, oldest.infrared.data(), sizeof(float) * WIDTH * HEIGHT);
  *ticks = oldest.ticks;
  *age_ns = std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now() - oldest.came).count();
  return 1;
}

// Deleting the device ends the threads that call the listener.
EXPORT void k2_close(Camera *camera) {
  camera->closing = true;
  camera->device->close();
  delete camera->device;
  delete camera;
}

// The errors since the last call. The text lives until this thread's next call.
EXPORT const char *k2_said() {
  static thread_local std::string said;
  said.clear();
  std::lock_guard<std::mutex> lock(errors().mutex);
  said.swap(errors().lines);
  return said.c_str();
}
