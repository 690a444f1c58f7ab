// Drivers of vitreo in C++17: one header over vitreo.h, which says what the calls do; see docs/drivers.md.
// A Driver leaves the run when it goes; what fails is thrown.
#ifndef VITREO_HPP
#define VITREO_HPP

#include "vitreo.h"

#include <chrono>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

namespace vitreo {

// A call that did not do what it was asked.
class Error : public std::runtime_error {
  public:
    Error(int code, const char *text) : std::runtime_error(text), code_(code) {}
    // One of VITREO_….
    int code() const noexcept { return code_; }

  private:
    int code_;
};

// The run has ended, or asks this program to end.
class Stopped : public Error {
    using Error::Error;
};

// Throws what a code means; returns it where it means no failure.
inline int check(int code) {
    if (code == VITREO_STOP)
        throw Stopped(code, vitreo_error_text());
    if (code < VITREO_OK)
        throw Error(code, vitreo_error_text());
    return code;
}

// Shared memory of a field of pixels, to be written before Driver::send_field.
struct Pixels {
    std::uint8_t *data;
    std::size_t size;
};

// A driver in a run. Only the thread that made it can use it.
class Driver {
  public:
    using Wait = std::chrono::milliseconds;

    // Joins a run, which is waited for; roles: a sum of VITREO_SENDS_… and VITREO_READS_….
    Driver(const std::string &instance, const std::string &name, std::uint32_t roles, Wait wait = Wait(0)) {
        check(vitreo_open(instance.c_str(), name.c_str(), roles, VITREO_LAYOUT, ms(wait), &driver_));
    }
    Driver(const Driver &) = delete;
    Driver &operator=(const Driver &) = delete;
    Driver(Driver &&other) noexcept : driver_(std::exchange(other.driver_, 0)) {}
    Driver &operator=(Driver &&other) noexcept {
        std::swap(driver_, other.driver_);
        return *this;
    }
    ~Driver() {
        if (driver_ != 0)
            vitreo_close(driver_);
    }

    // True while the run goes on.
    bool running() const {
        int code = vitreo_check(driver_);
        return code != VITREO_STOP && check(code) == VITREO_OK;
    }
    void send(const VitreoBlobField &field) { check(vitreo_send_blobs(driver_, &field, sizeof field)); }
    void send(const VitreoHandleState &handle) { check(vitreo_send_handle(driver_, &handle, sizeof handle)); }
    void send(const VitreoPedalState &pedal) { check(vitreo_send_pedal(driver_, &pedal, sizeof pedal)); }
    void send(const VitreoTrackerFrame &frame) { check(vitreo_send_poses(driver_, &frame, sizeof frame)); }
    Pixels lend_field(const VitreoFieldHeader &header) {
        Pixels pixels{};
        check(vitreo_lend_field(driver_, &header, sizeof header, &pixels.data, &pixels.size));
        return pixels;
    }
    void send_field() { check(vitreo_send_field(driver_)); }

    // The next block; nothing where none came in time.
    std::optional<VitreoTrackerFrame> next_poses(Wait wait = Wait(0)) { return next(vitreo_next_poses, wait); }
    std::optional<VitreoEvent> next_event(Wait wait = Wait(0)) { return next(vitreo_next_event, wait); }
    std::optional<VitreoHealth> next_health(Wait wait = Wait(0)) { return next(vitreo_next_health, wait); }

    // Says that it works, or does so with a limitation.
    void tell(bool degraded, const std::string &text) { check(vitreo_tell(driver_, degraded, text.c_str())); }
    // Says that nothing more will come.
    void finish() { check(vitreo_finish(driver_)); }

  private:
    static std::int32_t ms(Wait wait) { return static_cast<std::int32_t>(wait.count()); }
    template <typename Block>
    std::optional<Block> next(std::int32_t (*read)(std::uint64_t, Block *, std::size_t, std::int32_t), Wait wait) {
        Block block{};
        if (check(read(driver_, &block, sizeof block, ms(wait))) == VITREO_NOTHING)
            return std::nullopt;
        return block;
    }

    std::uint64_t driver_ = 0;
};

} // namespace vitreo

#endif
