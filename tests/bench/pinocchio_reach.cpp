// Inverse kinematics of one pose after another on Pinocchio: damped least squares with the joints clamped to their
// limits, from random starts until one arrives. One thread. Everything is allocated when the solver is made.
//
// As in pinocchio_clik.cpp: revolute-z joints, one pass for frames and Jacobian, fixed-size Eigen, LLT.

#include <cstdint>
#include <random>
#include <string>

#include <pinocchio/multibody.hpp>
#include <pinocchio/spatial.hpp>
#include <pinocchio/algorithm/jacobian.hpp>

#include <Eigen/Cholesky>

namespace {

using RowMatrix4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
using RowMatrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;
using pinocchio::SE3;

SE3 placement(const double *m) {  // 4x4, row by row
  const RowMatrix4 t = Eigen::Map<const RowMatrix4>(m);
  return SE3(t.topLeftCorner<3, 3>(), t.topRightCorner<3, 1>());
}

struct Options {
  double damping, of_error;  // lambda^2 = damping + of_error |e|^2
  double position, rotation;  // tolerances [m], [rad]
  std::int64_t iterations, starts;
};

template <int n>
struct Solver {
  using Joints = Eigen::Matrix<double, n, 1>;
  using Jacobian = Eigen::Matrix<double, 6, n>;

  pinocchio::Model model;
  pinocchio::Data data;
  SE3 tip;
  Joints lower, upper;
  Jacobian J;
  Eigen::LLT<Matrix6> factor;

  static pinocchio::Model build(const double *origins) {
    pinocchio::Model model;
    for (int i = 0; i < n; ++i)
      model.addJoint(i, pinocchio::JointModelRevoluteTpl<double, 0, 2>(), placement(origins + 16 * i), "q" + std::to_string(i + 1));
    return model;
  }

  Solver(const double *origins, const double *tip, const double *lower, const double *upper)
      : model(build(origins)), data(model), tip(placement(tip)), lower(Eigen::Map<const Joints>(lower)), upper(Eigen::Map<const Joints>(upper)) {
    J.setZero();
  }

  // Error and Jacobian at q, in the base frame at the tip; whether the pose is there.
  bool look(const Joints &q, const Eigen::Vector3d &position, const Eigen::Matrix3d &rotation, const Options &asked, Vector6 &e) {
    pinocchio::computeJointJacobians(model, data, q);
    const SE3 at = data.oMi[n] * tip;
    e.head<3>() = position - at.translation();
    e.tail<3>() = pinocchio::log3(Eigen::Matrix3d(rotation * at.rotation().transpose()));
    if (e.head<3>().squaredNorm() <= asked.position * asked.position && e.tail<3>().squaredNorm() <= asked.rotation * asked.rotation)
      return true;
    for (int i = 0; i < n; ++i) {  // data.J holds velocities of the point at the base's origin
      const Eigen::Vector3d spin = data.J.col(i).template tail<3>();
      J.col(i).template head<3>() = data.J.col(i).template head<3>() + spin.cross(at.translation());
      J.col(i).template tail<3>() = spin;
    }
    return false;
  }

  bool descend(Joints &q, const Eigen::Vector3d &position, const Eigen::Matrix3d &rotation, const Options &asked, std::int64_t &looks) {
    Vector6 e;
    Matrix6 gram;
    for (std::int64_t k = 0;; ++k) {
      ++looks;
      if (look(q, position, rotation, asked, e)) return true;
      if (k == asked.iterations) return false;
      gram.noalias() = J * J.transpose();
      gram.diagonal().array() += asked.damping + asked.of_error * e.squaredNorm();
      factor.compute(gram);
      q += J.transpose() * factor.solve(e);
      q = q.cwiseMax(lower).cwiseMin(upper);
    }
  }

  void run(const Options &asked, std::uint64_t seed, std::int64_t batch, const double *positions, const double *rotations,
           double *answers, std::uint8_t *found, std::int64_t *looks) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> uniform(0.0, 1.0);
    for (std::int64_t lane = 0; lane < batch; ++lane) {
      const Eigen::Vector3d position = Eigen::Map<const Eigen::Vector3d>(positions + 3 * lane);
      const Eigen::Matrix3d rotation = Eigen::Map<const RowMatrix3>(rotations + 9 * lane);
      Joints q;
      looks[lane] = found[lane] = 0;
      for (std::int64_t start = 0; start < asked.starts && !found[lane]; ++start) {
        for (int i = 0; i < n; ++i) q[i] = lower[i] + (upper[i] - lower[i]) * uniform(random);
        found[lane] = descend(q, position, rotation, asked, looks[lane]);
      }
      Eigen::Map<Joints>(answers + n * lane) = q;
    }
  }
};

}  // namespace

#define REACH(NAME, N)                                                                                                     \
  extern "C" void *NAME##_new(const double *origins, const double *tip, const double *lower, const double *upper) {        \
    return new Solver<N>(origins, tip, lower, upper);                                                                      \
  }                                                                                                                        \
  extern "C" void NAME##_run(void *solver, double damping, double of_error, double position, double rotation,              \
                             std::int64_t iterations, std::int64_t starts, std::uint64_t seed, std::int64_t batch,         \
                             const double *positions, const double *rotations, double *q, std::uint8_t *found,             \
                             std::int64_t *looks) {                                                                        \
    const Options asked{damping, of_error, position, rotation, iterations, starts};                                        \
    static_cast<Solver<N> *>(solver)->run(asked, seed, batch, positions, rotations, q, found, looks);                      \
  }                                                                                                                        \
  extern "C" void NAME##_delete(void *solver) { delete static_cast<Solver<N> *>(solver); }

REACH(reach_6, 6)
REACH(reach_7, 7)
