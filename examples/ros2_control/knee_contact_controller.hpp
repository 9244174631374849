// A chainable controller of ros2_control that computes the contact in a knee in each cycle.
//
// It reads the state interfaces of an encoder and a force sensor, calls the exported tick, and exports contact force,
// penetration depth and status as state interfaces, which a controller after it may claim. It stands beside
// force_torque_sensor_broadcaster, commands nothing, allocates nothing in a cycle and takes no topic.
#pragma once

#include <string>
#include <vector>

#include "controller_interface/chainable_controller_interface.hpp"
#include "knee_contact.h"

namespace knee_contact
{
class KneeContactController : public controller_interface::ChainableControllerInterface
{
public:
  controller_interface::CallbackReturn on_init() override;
  controller_interface::CallbackReturn on_configure(const rclcpp_lifecycle::State & previous) override;
  controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State & previous) override;
  controller_interface::InterfaceConfiguration command_interface_configuration() const override;
  controller_interface::InterfaceConfiguration state_interface_configuration() const override;

protected:
  std::vector<hardware_interface::StateInterface> on_export_state_interfaces() override;
  std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() override;
  controller_interface::return_type update_reference_from_subscribers(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;
  controller_interface::return_type update_and_write_commands(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;

private:
  std::string angle_interface_, force_interface_;
  double angle_scale_{1.0}, force_scale_{-0.5};
  knee_contact_state state_{};
  // What is exported; NaN, and the bits of KNEE_CONTACT_UNUSABLE, until a cycle has an answer.
  double contact_force_{NAN}, penetration_depth_{NAN}, status_{KNEE_CONTACT_UNUSABLE};
};
}  // namespace knee_contact
