// Plays recorded blobs into a run and reads the poses that come of them: blobs INSTANCE FILE (FILE by lines.py).
// The run: vitreo run --external blobs --rig RIG.json --instance INSTANCE
#include "vitreo.hpp"
#include <algorithm>
#include <fstream>
#include <iostream>
#include <thread>
#include <vector>

using namespace std::chrono_literals;
constexpr std::uint64_t PERIOD_NS = 20'000'000;

// The next camera-field of the file, as recorded.
static bool read(std::istream &file, VitreoBlobField &field) {
    std::uint32_t count = 0;
    field = {};
    file >> field.camera >> field.field >> field.exposed_ns >> field.read_out_ns >> field.parity >> count;
    for (std::uint32_t i = 0; i < count; i++) {
        VitreoBlob b{};
        b.var_x_px2 = b.var_y_px2 = 0.0025;
        file >> b.x_px >> b.y_field_px >> b.area_px >> b.width_px >> b.height_px >> b.colour;
        if (field.count < VITREO_MAX_BLOBS)
            field.blobs[field.count++] = b;
    }
    return bool(file);
}

int main(int argc, char **argv) try {
    std::ifstream file(argc == 3 ? argv[2] : "");
    if (!file)
        throw std::runtime_error("usage: blobs INSTANCE FILE");
    vitreo::Driver driver(argv[1], "cpp-example", VITREO_SENDS_BLOBS | VITREO_READS_POSES, 30s);
    const std::uint64_t start = vitreo_now();
    std::uint64_t first = 0;
    std::vector<double> ages_ms;
    for (VitreoBlobField field; driver.running() && read(file, field);) {
        first = first ? first : field.read_out_ns;
        field.field += start / PERIOD_NS; // rising where this program is started again
        field.exposed_ns += start - first;
        field.read_out_ns += start - first;
        std::int64_t early = std::int64_t(field.read_out_ns - vitreo_now());
        std::this_thread::sleep_for(std::chrono::nanoseconds(std::max<std::int64_t>(early, 0)));
        driver.send(field);
        while (auto poses = driver.next_poses())
            ages_ms.push_back(double(poses->instants.tracked - poses->instants.blobs_out) * 1e-6);
    }
    driver.finish();
    while (driver.running()) // the run ends in order
        std::this_thread::sleep_for(20ms);
    std::sort(ages_ms.begin(), ages_ms.end());
    if (ages_ms.empty())
        throw std::runtime_error("no poses came");
    std::cerr << ages_ms.size() << " poses; from blobs to poses " << ages_ms[ages_ms.size() / 2] << " ms (p50)\n";
} catch (const vitreo::Stopped &) {
    return 0; // asked to end before the end of the file
} catch (const std::exception &problem) {
    std::cerr << problem.what() << "\n";
    return 1;
}
