// Vehicles from LiDAR points: to body coordinates, cut off the ground, cluster on a grid, one box a cluster.
//
//   cmake -S . -B build && cmake --build build
//   fbench replay LOG -p 'exec:build/lidar_clusters'
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <map>

#include "fbench_exec.hpp"

namespace {

struct Params {
  double low_m = 0.3, high_m = 2.5;             // above the ground, which is assumed flat at z = 0 of the body
  double min_range_m = 2.5, max_range_m = 60;   // from the body's origin
  double max_side_m = 12;                       // left and right: what stands farther away is beside the road
  double cell_m = 0.6;
  std::size_t min_points = 10;
  double length_m = 4.4, width_m = 1.8, height_m = 1.6;  // a car's; what is seen of it is completed to that
  double max_extent_m = 9, min_extent_m = 0.7;           // anything else is a wall or a pole
};

using Cell = std::pair<int, int>;
using Clock = std::chrono::steady_clock;

struct Cluster {
  double x[2] = {1e9, -1e9}, y[2] = {1e9, -1e9}, z_max = -1e9;
  std::size_t num = 0;
  void add(const fbench::Vec3d& p) {
    x[0] = std::min(x[0], p[0]), x[1] = std::max(x[1], p[0]);
    y[0] = std::min(y[0], p[1]), y[1] = std::max(y[1], p[1]);
    z_max = std::max(z_max, p[2]);
    ++num;
  }
};

class LidarClusters : public fbench::Client {
 public:
  std::string name() const override { return "lidar_clusters 1"; }

  void start(const fbench::Hello& hello) override {
    hello_ = hello;
    const auto is_lidar = [](const fbench::Sensor& sensor) { return sensor.kind == fbench::Kind::lidar; };
    if (std::none_of(hello.sensors.begin(), hello.sensors.end(), is_lidar))
      throw std::runtime_error("the log has no LiDAR");
  }

  void reset(const std::string& reason) override { std::printf("reset: %s\n", reason.c_str()); }

  fbench::Output step(const fbench::Frame& frame) override {
    const auto begin = Clock::now();
    std::map<Cell, std::vector<fbench::Vec3d>> grid;  // ordered, so that the order of points doesn't matter
    for (const fbench::Message& message : frame.messages)
      if (const auto* cloud = message.as<fbench::PointCloud>()) fill(*cloud, hello_.sensor(message.sensor), grid);
    const auto filled = Clock::now();
    fbench::Output output;
    auto& detections = std::get<0>(output.boxes).detections;
    for (const Cluster& cluster : clusters(grid))
      if (is_vehicle(cluster)) detections.push_back(box(cluster));
    output.stages = {{"preprocess", ns(filled - begin)}, {"detect.lidar", ns(Clock::now() - filled)}};
    return output;
  }

 private:
  static std::uint64_t ns(Clock::duration d) {
    return static_cast<std::uint64_t>(std::chrono::duration_cast<std::chrono::nanoseconds>(d).count());
  }

  void fill(const fbench::PointCloud& cloud, const fbench::Sensor& sensor,
            std::map<Cell, std::vector<fbench::Vec3d>>& grid) const {
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      const fbench::Vec3d p = sensor.body_T_sensor(cloud.point(i));
      const double range_m = std::hypot(p[0], p[1]);
      if (!(p[2] > params_.low_m && p[2] < params_.high_m)) continue;
      if (!(range_m > params_.min_range_m && range_m < params_.max_range_m && std::abs(p[1]) < params_.max_side_m)) continue;
      grid[{static_cast<int>(std::floor(p[0] / params_.cell_m)), static_cast<int>(std::floor(p[1] / params_.cell_m))}]
          .push_back(p);
    }
  }

  // Cells that touch belong together.
  static std::vector<Cluster> clusters(const std::map<Cell, std::vector<fbench::Vec3d>>& grid) {
    std::vector<Cluster> found;
    std::map<Cell, bool> seen;
    for (const auto& [first, points] : grid) {
      if (seen[first]) continue;
      seen[first] = true;
      Cluster cluster;
      std::vector<Cell> open{first};
      while (!open.empty()) {
        const Cell cell = open.back();
        open.pop_back();
        for (const auto& p : grid.at(cell)) cluster.add(p);
        for (int dx = -1; dx <= 1; ++dx)
          for (int dy = -1; dy <= 1; ++dy) {
            const Cell next{cell.first + dx, cell.second + dy};
            if (grid.count(next) && !seen[next]) seen[next] = true, open.push_back(next);
          }
      }
      found.push_back(cluster);
    }
    return found;
  }

  bool is_vehicle(const Cluster& c) const {
    const double longer = std::max(c.x[1] - c.x[0], c.y[1] - c.y[0]);
    return c.num >= params_.min_points && longer > params_.min_extent_m && longer < params_.max_extent_m;
  }

  // Only faces towards the sensor are seen: the box grows away from it, along the road.
  fbench::Box3D box(const Cluster& c) const {
    const double length = std::max(c.x[1] - c.x[0], params_.length_m), width = std::max(c.y[1] - c.y[0], params_.width_m);
    const double height = std::max(c.z_max, params_.height_m);
    fbench::Box3D box;
    box.center_m = {away(c.x[0], c.x[1], length), away(c.y[0], c.y[1], width), height / 2};
    box.size_lwh_m = {length, width, height};
    box.score = static_cast<double>(c.num) / (static_cast<double>(c.num) + 30);
    box.sources = fbench::kLidar;
    return box;
  }

  static double away(double low, double high, double size) {
    if (low > 0) return low + size / 2;
    if (high < 0) return high - size / 2;
    return (low + high) / 2;
  }

  Params params_;
  fbench::Hello hello_;
};

}  // namespace

int main() {
  LidarClusters client;
  return fbench::run(client);
}
