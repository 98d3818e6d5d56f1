// Tells what it was sent: a box at each LiDAR's first point and, with --checksum, sums over all that it read.
// Used to measure what the exchange costs, and to test that both sides see the same numbers.
#include <cstdio>

#include "fbench_exec.hpp"

namespace {

// Sum of (i + 1) times the bits of value i, modulo 2^64: tells order and values.
template <class T, class Bits>
std::uint64_t checksum(const fbench::Array<T>& values) {
  static_assert(sizeof(T) == sizeof(Bits));
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const T value = values[i];
    Bits bits;
    std::memcpy(&bits, &value, sizeof(bits));
    sum += (i + 1) * bits;
  }
  return sum;
}

std::string text(const fbench::Array<float>& values) {
  return values.given() ? std::to_string(checksum<float, std::uint32_t>(values)) : "-";
}

class Echo : public fbench::Client {
 public:
  explicit Echo(bool with_checksum) : with_checksum_(with_checksum) {}
  std::string name() const override { return "echo"; }
  void start(const fbench::Hello& hello) override { std::printf("%s: %zu sensors\n", hello.log_name.c_str(), hello.sensors.size()); }
  void reset(const std::string& reason) override { std::printf("reset: %s\n", reason.c_str()); }

  fbench::Output step(const fbench::Frame& frame) override {
    fbench::Output output;
    auto& results = std::get<0>(output.boxes);
    for (const fbench::Message& message : frame.messages) {
      const auto* cloud = message.as<fbench::PointCloud>();
      if (cloud && cloud->size()) {
        const auto p = cloud->point(0);
        fbench::Box3D box;
        box.center_m = {p[0], p[1], p[2]};
        box.size_lwh_m = {1, 1, 1};
        box.score = 1;
        results.detections.push_back(box);
      }
      if (with_checksum_) output.missing[std::string(message.sensor)] = describe(message);
    }
    return output;
  }

 private:
  static std::string describe(const fbench::Message& message) {
    std::string out = std::to_string(message.stamp_ns) + " " + std::to_string(message.log_ns);
    if (const auto* cloud = message.as<fbench::PointCloud>()) {
      out += " points " + text(cloud->xyz_m) + " " + text(cloud->intensity);
      out += " " + (cloud->ring.given() ? std::to_string(checksum<std::uint16_t, std::uint16_t>(cloud->ring)) : "-");
      out += " " + (cloud->offset_ns.given() ? std::to_string(checksum<std::int32_t, std::uint32_t>(cloud->offset_ns)) : "-");
    } else if (const auto* scan = message.as<fbench::RadarScan>()) {
      out += " radar " + text(scan->xyz_m) + " " + text(scan->radial_velocity_mps) + " " + text(scan->rcs_dbsm);
      out += " " + text(scan->range_m) + " " + text(scan->azimuth_rad) + " " + text(scan->altitude_rad);
    } else if (const auto* image = message.as<fbench::Image>()) {
      out += " image " + std::string(image->encoding) + " " + std::to_string(image->width_px) + "x" + std::to_string(image->height_px);
      out += " " + std::to_string(checksum<std::uint8_t, std::uint8_t>(fbench::Array<std::uint8_t>(image->data)));
    } else if (const auto* pose = message.as<fbench::Pose>()) {
      char numbers[256];
      const auto& t = pose->translation_m;
      const auto& q = pose->rotation_xyzw;
      std::snprintf(numbers, sizeof(numbers), " pose %.17g %.17g %.17g %.17g %.17g %.17g %.17g", t[0], t[1], t[2], q[0], q[1], q[2], q[3]);
      out += numbers;
    }
    return out;
  }

  bool with_checksum_;
};

}  // namespace

int main(int argc, char** argv) {
  Echo echo(argc > 1 && std::string_view(argv[1]) == "--checksum");
  return fbench::run(echo);
}
