// The update of a ros2_control controller that uses the model. Copy the three functions into your own class, which
// derives from controller_interface::ControllerInterface and owns a Compensation; nothing here needs ROS.
#include "@{name}.h"

#include <array>
#include <cstddef>

namespace @{name}_control {

constexpr std::size_t size = @{NAME}_COORDINATES;
using Values = std::array<@{name}_real, size>;

class Compensation {
public:
    // In on_configure, with the update rate of the controller manager.
    bool configure(@{name}_real update_rate_hz)
    {
        const @{name}_real dt = @{one} / update_rate_hz;
        @{name}_init(&model_, @{name}_beta);
        tau_.fill(@{zero});
        return @{name}_observer_init(&observer_, @{gain}, dt) == 0;
    }

    // In update: positions and velocities of the state interfaces, in the order of the header; returns what to set
    // on the effort interfaces. Limit it before you do.
    const Values &update(const Values &q, const Values &qd)
    {
        @{name}_observer_update(&model_, &observer_, q.data(), qd.data(), tau_.data(), hand_.data());
        Values friction{};
        @{name}_gravity(&model_, q.data(), tau_.data());
        @{name}_friction_compensation(&model_, qd.data(), @{half}, friction.data());
        for (std::size_t i = 0; i < size; ++i) {
            tau_[i] += friction[i];
        }
        return tau_;
    }

    // The hand's torque on every coordinate.
    const Values &hand() const { return hand_; }

private:
    @{name}_model model_{};
    @{name}_observer observer_{};
    Values tau_{};
    Values hand_{};
};

}  // namespace @{name}_control
