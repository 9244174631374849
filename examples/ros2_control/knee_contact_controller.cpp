#include "knee_contact_controller.hpp"

#include <optional>

#include "pluginlib/class_list_macros.hpp"

// The knee of `knee-contact export healthy --output DIR --target x86-64`; another one has another name.
extern "C" const knee_contact_knee healthy;

namespace knee_contact
{
using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;

CallbackReturn KneeContactController::on_init()
{
  auto_declare<std::string>("angle_interface", "knee_right/position");
  auto_declare<std::string>("force_interface", "knee_right_force/force.y");
  auto_declare<double>("angle_scale", 1.0);   // to flexion [rad]; -1 where flexion is negative
  auto_declare<double>("force_scale", -0.5);  // to the compartment's load [N]: sign and share
  return CallbackReturn::SUCCESS;
}

CallbackReturn KneeContactController::on_configure(const rclcpp_lifecycle::State &)
{
  angle_interface_ = get_node()->get_parameter("angle_interface").as_string();
  force_interface_ = get_node()->get_parameter("force_interface").as_string();
  angle_scale_ = get_node()->get_parameter("angle_scale").as_double();
  force_scale_ = get_node()->get_parameter("force_scale").as_double();
  return CallbackReturn::SUCCESS;
}

CallbackReturn KneeContactController::on_activate(const rclcpp_lifecycle::State &)
{
  state_ = {};
  contact_force_ = penetration_depth_ = NAN;
  status_ = KNEE_CONTACT_UNUSABLE;
  return CallbackReturn::SUCCESS;
}

InterfaceConfiguration KneeContactController::command_interface_configuration() const
{
  return {interface_configuration_type::NONE, {}};
}

InterfaceConfiguration KneeContactController::state_interface_configuration() const
{
  return {interface_configuration_type::INDIVIDUAL, {angle_interface_, force_interface_}};
}

std::vector<hardware_interface::StateInterface> KneeContactController::on_export_state_interfaces()
{
  const std::string name = get_node()->get_name();
  std::vector<hardware_interface::StateInterface> exported;
  exported.emplace_back(name, "contact_force", &contact_force_);          // [N]
  exported.emplace_back(name, "penetration_depth", &penetration_depth_);  // [m]
  exported.emplace_back(name, "status", &status_);                        // bits of knee_contact.h
  return exported;
}

std::vector<hardware_interface::CommandInterface> KneeContactController::on_export_reference_interfaces()
{
  return {};
}

return_type KneeContactController::update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &)
{
  return return_type::OK;
}

return_type KneeContactController::update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration & period)
{
  const std::optional<double> angle = state_interfaces_[0].get_optional();
  const std::optional<double> force = state_interfaces_[1].get_optional();
  knee_contact_answer answer{};
  const bool answered =
    angle && force && knee_contact_tick(&healthy, &state_, period.seconds(), angle_scale_ * *angle,
                                        force_scale_ * *force, &answer) == KNEE_CONTACT_ANSWERED;
  // A cycle without a value is as long as the time that the next tick does not know of: it begins again.
  if (!answered) state_ = {};
  contact_force_ = answered ? answer.contact_force : NAN;
  penetration_depth_ = answered ? answer.penetration_depth : NAN;
  status_ = answered ? answer.status : static_cast<uint32_t>(KNEE_CONTACT_UNUSABLE);
  return return_type::OK;
}
}  // namespace knee_contact

PLUGINLIB_EXPORT_CLASS(knee_contact::KneeContactController, controller_interface::ChainableControllerInterface)
