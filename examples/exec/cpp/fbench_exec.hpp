// Everything that a C++ program needs to be run by `fbench replay -p exec:...`: C++17, POSIX, no other dependencies.
//
// Derive from fbench::Client and call fbench::run(client). The protocol is described in fbench_exec.proto, where units
// and coordinate frames are stated; this header reads and writes just that schema.
#pragma once

#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <map>
#include <memory>
#include <new>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "arrays of the protocol are little-endian"
#endif

namespace fbench {

inline constexpr std::uint32_t kVersion = 1;
inline constexpr std::uint32_t kMaxRequestBytes = 1u << 30;  // longer requests are refused

// ---------------------------------------------------------------- what fbench sends

// N values where they lie in the request, which needn't be aligned. Valid until `step` returns.
template <class T>
class Array {
 public:
  Array() = default;
  explicit Array(std::string_view bytes) : data_(bytes.data()), size_(bytes.size() / sizeof(T)), given_(true) {
    if (bytes.size() % sizeof(T) != 0) throw std::runtime_error("array of a broken length");
  }
  bool given() const { return given_; }  // false: the sensor doesn't measure it
  std::size_t size() const { return size_; }
  T operator[](std::size_t i) const {
    T value;
    std::memcpy(&value, data_ + i * sizeof(T), sizeof(T));
    return value;
  }
  const char* bytes() const { return data_; }

 private:
  const char* data_ = nullptr;
  std::size_t size_ = 0;
  bool given_ = false;
};

template <class T>
using Vec3 = std::array<T, 3>;
using Vec3d = Vec3<double>;

// Rotation and translation: dst_T_src.
class Transform {
 public:
  Transform() : Transform({0, 0, 0}, {0, 0, 0, 1}) {}
  Transform(const Vec3d& translation_m, const std::array<double, 4>& rotation_xyzw) : t_(translation_m) {
    const auto [x, y, z, w] = rotation_xyzw;
    r_ = {{{1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
           {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
           {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}}};
  }
  template <class T>
  Vec3d operator()(const Vec3<T>& p) const {
    Vec3d q = t_;
    for (int i = 0; i < 3; ++i) q[i] += r_[i][0] * p[0] + r_[i][1] * p[1] + r_[i][2] * p[2];
    return q;
  }

 private:
  std::array<Vec3d, 3> r_{};
  Vec3d t_{};
};

enum class Kind { unknown = 0, camera = 1, lidar = 2, radar = 3 };

struct Camera {
  std::array<double, 9> k{};  // [px], row by row
  std::uint32_t width_px = 0, height_px = 0;
  std::string distortion_model;  // as in ROS; empty: none
  std::vector<double> distortion;
};

struct Sensor {
  std::string name;
  Kind kind = Kind::unknown;
  Transform body_T_sensor;
  Vec3d translation_m{};
  std::array<double, 4> rotation_xyzw{0, 0, 0, 1};
  std::optional<Camera> camera;
};

struct Hello {
  std::uint32_t version = 0;
  std::string log_name, log_id;
  std::map<std::string, std::string> metadata;
  std::vector<Sensor> sensors;

  const Sensor& sensor(std::string_view name) const {
    for (const Sensor& s : sensors)
      if (s.name == name) return s;
    throw std::runtime_error("no sensor '" + std::string(name) + "' in the rig");
  }
};

struct Image {
  std::string_view encoding;  // jpeg, png, webp, or a raw layout such as rgb8
  std::uint32_t width_px = 0, height_px = 0;
  std::string_view data;
};

namespace detail {
inline Vec3<float> point(const Array<float>& xyz, std::size_t i) { return {xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]}; }
inline void require(bool holds, const char* what) {
  if (!holds) throw std::runtime_error(what);
}
}  // namespace detail

// One LiDAR sweep, in the sensor's coordinate frame.
struct PointCloud {
  Array<float> xyz_m;               // 3 N
  Array<float> intensity;           // N, where given
  Array<std::uint16_t> ring;        // N, where given
  Array<std::int32_t> offset_ns;    // N, where given: time after the message's stamp
  std::size_t size() const { return xyz_m.size() / 3; }
  Vec3<float> point(std::size_t i) const { return detail::point(xyz_m, i); }
};

// One radar scan, in the sensor's coordinate frame.
struct RadarScan {
  Array<float> xyz_m;                // 3 N
  Array<float> radial_velocity_mps;  // N, where given: positive when receding
  Array<float> rcs_dbsm, range_m, azimuth_rad, altitude_rad;
  std::size_t size() const { return xyz_m.size() / 3; }
  Vec3<float> point(std::size_t i) const { return detail::point(xyz_m, i); }
};

// world_T_body.
struct Pose {
  Vec3d translation_m{};
  std::array<double, 4> rotation_xyzw{0, 0, 0, 1};
  Transform world_T_body() const { return {translation_m, rotation_xyzw}; }
};

struct Message {
  std::string_view sensor;
  std::int64_t stamp_ns = 0, log_ns = 0;
  std::variant<std::monostate, Image, PointCloud, RadarScan, Pose> content;

  template <class T>
  const T* as() const { return std::get_if<T>(&content); }  // null where it is something else
};

struct Frame {
  std::uint64_t index = 0;
  std::int64_t stamp_ns = 0;
  std::uint32_t segment = 0;
  std::vector<Message> messages;                                // sorted by sensor
  std::map<std::string_view, std::string_view> missing;         // sensor, why
  std::optional<std::int64_t> frame_number;
};

// ---------------------------------------------------------------- what you answer

enum Source : std::uint32_t { kCamera = 1, kLidar = 2, kRadar = 4, kStereo = 8 };

// In body coordinates at the frame's stamp. A field must be given for all boxes of a list or for none.
struct Box3D {
  Vec3d center_m{};
  Vec3d size_lwh_m{};  // length along heading, width, height
  double yaw_rad = 0;  // about z
  std::optional<double> roll_rad, pitch_rad;
  std::optional<Vec3d> velocity_mps;  // over ground, in body axes; NaN where unknown
  std::optional<std::string> label;   // car van truck bus trailer motorcycle bicycle pedestrian other
  std::optional<double> score;
  std::optional<std::int64_t> track_id;
  std::optional<std::uint32_t> sources;  // sum of `Source`
  std::optional<bool> predicted;
};

// In the image of one camera; pixel centres are at integers.
struct Box2D {
  std::string camera;
  std::array<double, 4> xyxy_px{};  // left, top, right, bottom
  std::optional<std::array<double, 4>> visible_xyxy_px;
  std::optional<std::string> label;
  std::optional<double> score;
  std::optional<std::int64_t> track_id;
  std::optional<double> distance_m, range_rate_mps;
  std::optional<std::uint32_t> sources;
  std::optional<bool> predicted;
};

template <class Box>
struct Results {
  std::vector<Box> detections, tracks;
  bool is_tracked = true;  // false: you only detect, so that there are no scores of tracks
};

struct Stage {
  std::string name;
  std::uint64_t duration_ns = 0;
};

struct Output {
  std::variant<Results<Box3D>, Results<Box2D>> boxes;  // the same kind in all frames
  std::vector<Stage> stages;
  std::map<std::string, std::string> missing;  // sensors that couldn't be used: why
};

// What you write. An exception fails the frame and is told to fbench; the next frame comes.
class Client {
 public:
  virtual ~Client() = default;
  virtual std::string name() const = 0;
  virtual void start(const Hello& hello) = 0;         // a log begins, or its calibration changes
  virtual void reset(const std::string& reason) = 0;  // forget all tracks
  virtual Output step(const Frame& frame) = 0;
};

// ---------------------------------------------------------------- protobuf, as far as the schema needs it

namespace detail {

class Reader {
 public:
  explicit Reader(std::string_view data) : p_(data.data()), end_(data.data() + data.size()) {}

  bool next() {  // to the next field; false at the end
    if (p_ == end_) return false;
    const std::uint64_t key = varint();
    number = static_cast<std::uint32_t>(key >> 3);
    wire_ = static_cast<int>(key & 7);
    value_ = 0;
    bytes_ = {};
    switch (wire_) {
      case 0: value_ = varint(); break;
      case 1: bytes_ = take(8); break;
      case 2: bytes_ = take(varint()); break;
      case 5: bytes_ = take(4); break;
      default: throw std::runtime_error("request of an unknown form");
    }
    return true;
  }

  std::uint32_t number = 0;
  std::uint64_t integer() const { require(wire_ == 0, "expected a number"); return value_; }
  std::int64_t signed_integer() const { return static_cast<std::int64_t>(integer()); }
  std::string_view bytes() const { require(wire_ == 2, "expected bytes"); return bytes_; }
  std::string text() const { return std::string(bytes()); }

  void doubles(std::vector<double>& out) const {  // packed, or one by one
    require((wire_ == 2 || wire_ == 1) && bytes_.size() % 8 == 0, "expected doubles");
    const std::size_t num = bytes_.size() / 8, before = out.size();
    out.resize(before + num);
    if (num) std::memcpy(out.data() + before, bytes_.data(), bytes_.size());
  }

 private:
  std::uint64_t varint() {
    std::uint64_t value = 0;
    for (int shift = 0; shift < 64; shift += 7) {
      require(p_ != end_, "request ends too early");
      const auto byte = static_cast<unsigned char>(*p_++);
      value |= static_cast<std::uint64_t>(byte & 0x7F) << shift;
      if (!(byte & 0x80)) return value;
    }
    throw std::runtime_error("number is too long");
  }
  std::string_view take(std::uint64_t num) {
    require(num <= static_cast<std::uint64_t>(end_ - p_), "request ends too early");
    const std::string_view taken(p_, num);
    p_ += num;
    return taken;
  }

  const char *p_, *end_;
  int wire_ = 0;
  std::uint64_t value_ = 0;
  std::string_view bytes_;
};

class Writer {
 public:
  std::string data;

  void integer(std::uint32_t number, std::uint64_t value) { key(number, 0); varint(value); }
  void bytes(std::uint32_t number, std::string_view value) { key(number, 2); varint(value.size()); data.append(value); }
  void pair(std::uint32_t number, std::string_view a, std::string_view b) {
    Writer entry;
    entry.bytes(1, a);
    entry.bytes(2, b);
    bytes(number, entry.data);
  }
  void doubles(std::uint32_t number, const std::vector<double>& values) {
    if (values.empty()) return;
    key(number, 2);
    varint(values.size() * 8);
    data.append(reinterpret_cast<const char*>(values.data()), values.size() * 8);
  }
  void integers(std::uint32_t number, const std::vector<std::uint64_t>& values) {
    if (values.empty()) return;
    Writer packed;
    for (const std::uint64_t value : values) packed.varint(value);
    bytes(number, packed.data);
  }

 private:
  void key(std::uint32_t number, std::uint32_t wire) { varint(number << 3 | wire); }
  void varint(std::uint64_t value) {
    for (; value > 0x7F; value >>= 7) data.push_back(static_cast<char>((value & 0x7F) | 0x80));
    data.push_back(static_cast<char>(value));
  }
};

template <std::size_t N>
std::array<double, N> fixed(const std::vector<double>& values) {
  require(values.size() == N, "vector of a wrong length");
  std::array<double, N> out;
  std::memcpy(out.data(), values.data(), sizeof(out));
  return out;
}

template <class Map>
void put_entry(std::string_view data, Map& map) {
  std::string_view key, value;
  for (Reader r(data); r.next();) {
    if (r.number == 1) key = r.bytes();
    if (r.number == 2) value = r.bytes();
  }
  map[typename Map::key_type(key)] = typename Map::mapped_type(value);
}

inline Camera read_camera(std::string_view data) {
  Camera camera;
  std::vector<double> k;
  for (Reader r(data); r.next();) {
    switch (r.number) {
      case 1: r.doubles(k); break;
      case 2: camera.width_px = static_cast<std::uint32_t>(r.integer()); break;
      case 3: camera.height_px = static_cast<std::uint32_t>(r.integer()); break;
      case 4: camera.distortion_model = r.text(); break;
      case 5: r.doubles(camera.distortion); break;
    }
  }
  camera.k = fixed<9>(k);
  return camera;
}

inline Sensor read_sensor(std::string_view data) {
  Sensor sensor;
  std::vector<double> translation, rotation;
  for (Reader r(data); r.next();) {
    switch (r.number) {
      case 1: sensor.name = r.text(); break;
      case 2: sensor.kind = static_cast<Kind>(r.integer()); break;
      case 3: r.doubles(translation); break;
      case 4: r.doubles(rotation); break;
      case 5: sensor.camera = read_camera(r.bytes()); break;
    }
  }
  sensor.translation_m = fixed<3>(translation);
  sensor.rotation_xyzw = fixed<4>(rotation);
  sensor.body_T_sensor = Transform(sensor.translation_m, sensor.rotation_xyzw);
  return sensor;
}

inline Hello read_hello(std::string_view data) {
  Hello hello;
  for (Reader r(data); r.next();) {
    switch (r.number) {
      case 1: hello.version = static_cast<std::uint32_t>(r.integer()); break;
      case 2: hello.log_name = r.text(); break;
      case 3: hello.log_id = r.text(); break;
      case 4: put_entry(r.bytes(), hello.metadata); break;
      case 5: hello.sensors.push_back(read_sensor(r.bytes())); break;
    }
  }
  return hello;
}

inline Image read_image(std::string_view data) {
  Image image;
  for (Reader r(data); r.next();) {
    switch (r.number) {
      case 1: image.encoding = r.bytes(); break;
      case 2: image.width_px = static_cast<std::uint32_t>(r.integer()); break;
      case 3: image.height_px = static_cast<std::uint32_t>(r.integer()); break;
      case 4: image.data = r.bytes(); break;
    }
  }
  return image;
}

template <class T>
void require_column(const Array<T>& column, std::size_t num) {
  require(!column.given() || column.size() == num, "column of a wrong length");
}

inline PointCloud read_points(std::string_view data) {
  PointCloud cloud;
  for (Reader r(data); r.next();) {
    switch (r.number) {
      case 1: cloud.xyz_m = Array<float>(r.bytes()); break;
      case 2: cloud.intensity = Array<float>(r.bytes()); break;
      case 3: cloud.ring = Array<std::uint16_t>(r.bytes()); break;
      case 4: cloud.offset_ns = Array<std::int32_t>(r.bytes()); break;
    }
  }
  require(cloud.xyz_m.size() % 3 == 0, "points of a wrong length");
  require_column(cloud.intensity, cloud.size());
  require_column(cloud.ring, cloud.size());
  require_column(cloud.offset_ns, cloud.size());
  return cloud;
}

inline RadarScan read_radar(std::string_view data) {
  RadarScan scan;
  Array<float>* const columns[] = {&scan.xyz_m, &scan.radial_velocity_mps, &scan.rcs_dbsm,
                                   &scan.range_m, &scan.azimuth_rad, &scan.altitude_rad};
  for (Reader r(data); r.next();)
    if (r.number >= 1 && r.number <= 6) *columns[r.number - 1] = Array<float>(r.bytes());
  require(scan.xyz_m.size() % 3 == 0, "points of a wrong length");
  for (int i = 1; i < 6; ++i) require_column(*columns[i], scan.size());
  return scan;
}

inline Pose read_pose(std::string_view data) {
  std::vector<double> translation, rotation;
  for (Reader r(data); r.next();) {
    if (r.number == 1) r.doubles(translation);
    if (r.number == 2) r.doubles(rotation);
  }
  return {fixed<3>(translation), fixed<4>(rotation)};
}

inline Message read_message(std::string_view data) {
  Message message;
  for (Reader r(data); r.next();) {
    switch (r.number) {
      case 1: message.sensor = r.bytes(); break;
      case 2: message.stamp_ns = r.signed_integer(); break;
      case 3: message.log_ns = r.signed_integer(); break;
      case 4: message.content = read_image(r.bytes()); break;
      case 5: message.content = read_points(r.bytes()); break;
      case 6: message.content = read_radar(r.bytes()); break;
      case 7: message.content = read_pose(r.bytes()); break;
    }
  }
  return message;
}

inline Frame read_frame(std::string_view data) {
  Frame frame;
  for (Reader r(data); r.next();) {
    switch (r.number) {
      case 1: frame.index = r.integer(); break;
      case 2: frame.stamp_ns = r.signed_integer(); break;
      case 3: frame.segment = static_cast<std::uint32_t>(r.integer()); break;
      case 4: frame.messages.push_back(read_message(r.bytes())); break;
      case 5: put_entry(r.bytes(), frame.missing); break;
      case 6: frame.frame_number = r.signed_integer(); break;
    }
  }
  return frame;
}

// Passes the values of one optional field to `put`; it must be given for all boxes or for none.
template <class Box, class T, class Put>
void for_given(const std::vector<Box>& boxes, std::optional<T> Box::*field, const char* name, Put put) {
  std::size_t num = 0;
  for (const Box& box : boxes) num += (box.*field).has_value();
  if (num != 0 && num != boxes.size()) throw std::runtime_error(std::string(name) + " is given for some boxes only");
  if (num)
    for (const Box& box : boxes) put(*(box.*field));
}

template <class Box>
void write_numbers(Writer& w, std::uint32_t number, const std::vector<Box>& boxes, std::optional<double> Box::*field,
                   const char* name) {
  std::vector<double> values;
  for_given(boxes, field, name, [&](double value) { values.push_back(value); });
  w.doubles(number, values);
}

template <std::size_t N, class Box>
void write_vectors(Writer& w, std::uint32_t number, const std::vector<Box>& boxes,
                   std::optional<std::array<double, N>> Box::*field, const char* name) {
  std::vector<double> values;
  for_given(boxes, field, name, [&](const auto& v) { values.insert(values.end(), v.begin(), v.end()); });
  w.doubles(number, values);
}

template <class Box, class T>
void write_integers(Writer& w, std::uint32_t number, const std::vector<Box>& boxes, std::optional<T> Box::*field,
                    const char* name) {
  std::vector<std::uint64_t> values;
  for_given(boxes, field, name, [&](T value) { values.push_back(static_cast<std::uint64_t>(value)); });
  w.integers(number, values);
}

inline std::string boxes_data(const std::vector<Box3D>& boxes) {
  Writer w;
  std::vector<double> center, size, yaw;
  for (const Box3D& b : boxes) {
    center.insert(center.end(), b.center_m.begin(), b.center_m.end());
    size.insert(size.end(), b.size_lwh_m.begin(), b.size_lwh_m.end());
    yaw.push_back(b.yaw_rad);
  }
  w.doubles(1, center);
  w.doubles(2, size);
  w.doubles(3, yaw);
  write_numbers(w, 4, boxes, &Box3D::roll_rad, "roll_rad");
  write_numbers(w, 5, boxes, &Box3D::pitch_rad, "pitch_rad");
  write_vectors(w, 6, boxes, &Box3D::velocity_mps, "velocity_mps");
  for_given(boxes, &Box3D::label, "label", [&](const std::string& text) { w.bytes(7, text); });
  write_numbers(w, 8, boxes, &Box3D::score, "score");
  write_integers(w, 9, boxes, &Box3D::track_id, "track_id");
  write_integers(w, 10, boxes, &Box3D::sources, "sources");
  write_integers(w, 11, boxes, &Box3D::predicted, "predicted");
  return w.data;
}

inline std::string boxes_data(const std::vector<Box2D>& boxes) {
  Writer w;
  std::vector<double> corners;
  for (const Box2D& b : boxes) {
    w.bytes(1, b.camera);
    corners.insert(corners.end(), b.xyxy_px.begin(), b.xyxy_px.end());
  }
  w.doubles(2, corners);
  write_vectors(w, 3, boxes, &Box2D::visible_xyxy_px, "visible_xyxy_px");
  for_given(boxes, &Box2D::label, "label", [&](const std::string& text) { w.bytes(4, text); });
  write_numbers(w, 5, boxes, &Box2D::score, "score");
  write_integers(w, 6, boxes, &Box2D::track_id, "track_id");
  write_numbers(w, 7, boxes, &Box2D::distance_m, "distance_m");
  write_numbers(w, 8, boxes, &Box2D::range_rate_mps, "range_rate_mps");
  write_integers(w, 9, boxes, &Box2D::sources, "sources");
  write_integers(w, 10, boxes, &Box2D::predicted, "predicted");
  return w.data;
}

inline std::string output_data(const Output& output) {
  Writer w;
  const auto put = [&](const auto& results) {
    Writer inner;
    inner.bytes(1, boxes_data(results.detections));
    if (results.is_tracked || !results.tracks.empty()) inner.bytes(2, boxes_data(results.tracks));
    w.bytes(output.boxes.index() == 0 ? 1 : 2, inner.data);
  };
  std::visit(put, output.boxes);
  for (const Stage& stage : output.stages) {
    Writer inner;
    inner.bytes(1, stage.name);
    inner.integer(2, stage.duration_ns);
    w.bytes(3, inner.data);
  }
  for (const auto& [sensor, why] : output.missing) w.pair(4, sensor, why);
  return w.data;
}

// Keeps stdin and stdout for itself: what is printed goes to stderr, and what is read finds nothing.
class Pipes {
 public:
  Pipes() : in_(::fcntl(0, F_DUPFD_CLOEXEC, 3)), out_(::fcntl(1, F_DUPFD_CLOEXEC, 3)) {
    require(in_ >= 0 && out_ >= 0, "stdin or stdout is closed");
    const int nothing = ::open("/dev/null", O_RDONLY);
    ::dup2(nothing, 0);
    ::close(nothing);
    std::fflush(stdout);
    ::dup2(2, 1);
    std::signal(SIGPIPE, SIG_IGN);
  }
  Pipes(const Pipes&) = delete;
  Pipes& operator=(const Pipes&) = delete;

  bool read(char* to, std::size_t num) const {  // false where stdin ends
    while (num) {
      const ssize_t got = ::read(in_, to, num);
      if (got == 0) return false;
      if (got < 0 && errno != EINTR) throw std::runtime_error("stdin can't be read");
      if (got > 0) to += got, num -= static_cast<std::size_t>(got);
    }
    return true;
  }
  void write(std::string_view data) const {
    while (!data.empty()) {
      const ssize_t done = ::write(out_, data.data(), data.size());
      if (done < 0 && errno != EINTR) throw std::runtime_error("fbench doesn't listen any more");
      if (done > 0) data.remove_prefix(static_cast<std::size_t>(done));
    }
  }

 private:
  int in_, out_;
};

// A request with its length before it, in memory that is used again for the next one and never cleared. It begins at a
// page, as the request does in the pipe: copies between equal alignments are several times faster.
class Buffer {
 public:
  std::optional<std::string_view> read(const Pipes& pipes) {  // nothing where stdin ends
    std::uint32_t num = 0;
    if (!pipes.read(grown(kHead, 0), kHead)) return std::nullopt;
    std::memcpy(&num, data_.get(), kHead);
    require(num <= kMaxRequestBytes, "request is too long");
    char* const body = grown(kHead + num, kHead) + kHead;
    require(pipes.read(body, num), "stdin ends within a request");
    return std::string_view(body, num);
  }

 private:
  static constexpr std::size_t kHead = sizeof(std::uint32_t), kPage = 4096;
  struct Free {
    void operator()(char* p) const { std::free(p); }
  };

  char* grown(std::size_t num, std::size_t kept) {
    if (num > capacity_) {
      capacity_ = (num + num / 4 + kPage) / kPage * kPage;
      std::unique_ptr<char, Free> larger(static_cast<char*>(std::aligned_alloc(kPage, capacity_)));
      if (!larger) throw std::bad_alloc();
      if (kept) std::memcpy(larger.get(), data_.get(), kept);
      data_ = std::move(larger);
    }
    return data_.get();
  }

  std::unique_ptr<char, Free> data_;
  std::size_t capacity_ = 0;
};

inline void answer(Client& client, std::uint32_t kind, std::string_view data, Writer& response) {
  Writer inner;
  switch (kind) {
    case 2: {
      const Hello hello = read_hello(data);
      require(hello.version == kVersion, "this program speaks version 1 of the protocol");
      client.start(hello);
      inner.integer(1, kVersion);
      inner.bytes(2, client.name());
      response.bytes(2, inner.data);
      return;
    }
    case 3: {
      std::string reason;
      for (Reader r(data); r.next();)
        if (r.number == 1) reason = r.text();
      client.reset(reason);
      response.bytes(3, "");
      return;
    }
    case 4: response.bytes(4, output_data(client.step(read_frame(data)))); return;
    default: throw std::runtime_error("this request isn't known");
  }
}

inline std::string response_to(Client& client, std::string_view request) {
  std::uint64_t sequence = 0;
  Writer response;
  try {
    std::uint32_t kind = 0;
    std::string_view data;
    for (Reader r(request); r.next();) {
      if (r.number == 1) sequence = r.integer();
      if (r.number >= 2 && r.number <= 4) kind = r.number, data = r.bytes();
    }
    answer(client, kind, data, response);
  } catch (const std::exception& error) {
    response.data.clear();
    response.bytes(5, error.what());
  }
  Writer head;
  head.integer(1, sequence);
  return head.data + response.data;
}

}  // namespace detail

// Answers fbench until it closes stdin; returns the program's exit code.
inline int run(Client& client) {
  try {
    const detail::Pipes pipes;
    detail::Buffer buffer;
    while (const auto request = buffer.read(pipes)) {
      const std::string response = detail::response_to(client, *request);
      const auto size = static_cast<std::uint32_t>(response.size());
      pipes.write(std::string(reinterpret_cast<const char*>(&size), sizeof(size)) + response);
    }
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "fbench client: %s\n", error.what());
    return 1;
  }
}

}  // namespace fbench
