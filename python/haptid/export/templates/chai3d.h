// @{title} in CHAI3D: any haptic device with this header around it carries its own weight, and a share of its friction.
//
//     chai3d::cGenericHapticDevicePtr device;
//     handler->getDevice(device, 0);
//     device = std::make_shared<@{name}_compensated>(device);  // nothing else changes
//
// The model is in @{name}.h and @{name}.c; compile the latter as C and link it. Angles of the joints come from
// getJointAnglesRad; override `coordinates` where their order, signs or zeros are not those of @{name}.h. Forces go out
// at the handle, so that what the model wants there is the force equivalent to its torques.
#ifndef @{NAME}_CHAI3D_H
#define @{NAME}_CHAI3D_H

#include "@{name}.h"
#include "chai3d.h"

#include <array>
#include <cmath>

class @{name}_compensated : public chai3d::cGenericHapticDevice {
public:
    using Values = std::array<@{name}_real, @{NAME}_COORDINATES>;

    // `frame` turns vectors of the model's base frame into CHAI3D's: x to the user, y to the right, z up.
    explicit @{name}_compensated(chai3d::cGenericHapticDevicePtr device,
                                 const chai3d::cMatrix3d &frame = chai3d::cMatrix3d(1, 0, 0, 0, 1, 0, 0, 0, 1),
                                 @{name}_real gravity_share = @{one}, @{name}_real friction_share = @{zero})
        : device_(device), frame_(frame), gravity_(gravity_share), friction_(friction_share)
    {
        m_specifications = device_->getSpecifications();
        @{name}_init(&model_, @{name}_beta);
    }

    // The force at the handle that carries the weight at these joints, N, in CHAI3D's frame; zero where none does.
    chai3d::cVector3d compensation(const Values &q, const Values &qd) const
    {
        Values tau{}, friction{};
        @{name}_real force[3];
        @{name}_gravity(&model_, q.data(), tau.data());
        @{name}_friction_compensation(&model_, qd.data(), friction_, friction.data());
        for (std::size_t i = 0; i < tau.size(); ++i) {
            tau[i] = gravity_ * tau[i] + friction[i];
        }
        if (@{name}_handle_force(q.data(), tau.data(), force) != 0) {
            return chai3d::cVector3d(0, 0, 0);  // singular pose
        }
        return frame_ * chai3d::cVector3d(force[0], force[1], force[2]);
    }

    bool setForceAndTorqueAndGripperForce(const chai3d::cVector3d &force, const chai3d::cVector3d &torque,
                                          const double gripper) override
    {
        double angles[chai3d::C_MAX_DOF] = {};
        m_prevForce = force;  // what was asked for: getForce tells what the user should feel
        if (!device_->getJointAnglesRad(angles)) {
            return device_->setForceAndTorqueAndGripperForce(force, torque, gripper);
        }
        const Values q = coordinates(angles);
        const double now = clock_.getCPUTimeSeconds();
        Values qd{};
        for (std::size_t i = 0; i < q.size(); ++i) {
            const double dt = now - then_;
            qd[i] = started_ && dt > 0 ? static_cast<@{name}_real>((q[i] - before_[i]) / dt) : @{zero};
        }
        before_ = q;
        then_ = now;
        started_ = true;
        return device_->setForceAndTorqueAndGripperForce(force + compensation(q, qd), torque, gripper);
    }

    bool open() override { return m_deviceReady = device_->open(); }
    bool close() override { m_deviceReady = false; return device_->close(); }
    bool calibrate(bool forced = false) override { return device_->calibrate(forced); }
    bool getPosition(chai3d::cVector3d &position) override { return device_->getPosition(position); }
    bool getRotation(chai3d::cMatrix3d &rotation) override { return device_->getRotation(rotation); }
    bool getLinearVelocity(chai3d::cVector3d &velocity) override { return device_->getLinearVelocity(velocity); }
    bool getAngularVelocity(chai3d::cVector3d &velocity) override { return device_->getAngularVelocity(velocity); }
    bool getJointAnglesRad(double angles[chai3d::C_MAX_DOF]) override { return device_->getJointAnglesRad(angles); }
    bool getGripperAngleRad(double &angle) override { return device_->getGripperAngleRad(angle); }
    bool getUserSwitch(int index, bool &pressed) override { return device_->getUserSwitch(index, pressed); }
    bool getUserSwitches(unsigned int &pressed) override { return device_->getUserSwitches(pressed); }

protected:
    // Coordinates of the model from the angles that the device gives.
    virtual Values coordinates(const double angles[chai3d::C_MAX_DOF]) const
    {
        Values q{};
        for (std::size_t i = 0; i < q.size(); ++i) {
            q[i] = static_cast<@{name}_real>(angles[i]);
        }
        return q;
    }

private:
    chai3d::cGenericHapticDevicePtr device_;
    chai3d::cMatrix3d frame_;
    @{name}_real gravity_;
    @{name}_real friction_;
    @{name}_model model_{};
    chai3d::cPrecisionClock clock_;
    Values before_{};
    double then_ = 0.0;
    bool started_ = false;
};

#endif
