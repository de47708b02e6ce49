// What the adapters use of rclcpp: publishing a torque moves the plant, spinning brings its state.
#pragma once
#include <functional>
#include <memory>
#include <string>
#include "plant.h"
namespace stub { struct Stamp { double seconds = 0.0; }; }
namespace rclcpp {
struct Duration { double x; double seconds() const { return x; } };
struct Time {
    double x = 0.0;
    Time() = default;
    explicit Time(const stub::Stamp &stamp) : x(stamp.seconds) {}
    Duration operator-(const Time &o) const { return {x - o.x}; }
};
inline std::function<void()> &spinning() { static std::function<void()> call; return call; }
inline void init(int, char **) {}
inline bool ok() { return true; }
inline void shutdown() {}
template <typename T> void spin_some(const T &) { spinning()(); }
template <typename M> struct Publisher {
    using SharedPtr = std::shared_ptr<Publisher>;
    void publish(const M &message) { plant_torque(message.effort.data()); }
};
template <typename M> struct Subscription { using SharedPtr = std::shared_ptr<Subscription>; };
class Node {
public:
    explicit Node(const std::string &) {}
    template <typename T> T declare_parameter(const std::string &name, const T &value)
    {
        return name == "kp" ? 1.0 : name == "kd" ? 0.05 : name == "speed" ? 1.0 : value;
    }
    template <typename M> std::shared_ptr<Publisher<M>> create_publisher(const std::string &, int)
    {
        return std::make_shared<Publisher<M>>();
    }
    template <typename M, typename F> std::shared_ptr<Subscription<M>> create_subscription(const std::string &, int, F call)
    {
        spinning() = [call]() {
            auto state = std::make_shared<M>();
            state->header.stamp.seconds = plant_t;
            state->position.assign(plant_q, plant_q + 3);
            state->effort.assign(3, 0.25);
            call(state);
        };
        return std::make_shared<Subscription<M>>();
    }
};
}
