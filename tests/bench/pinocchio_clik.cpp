// The Panda's pose loop on Pinocchio: damped least squares, stepped by explicit Euler or by the paper's
// Crank-Nicolson with M Picard passes. One thread. Everything is allocated when the solver is made.
//
// Written to be as fast as Pinocchio's own interface allows: revolute-z joints (no general axis), one pass for
// frames and Jacobian (`computeJointJacobians`; the local-frame `computeJointJacobian` was slower), fixed-size
// Eigen, LLᵀ (faster than Eigen's pivoting LDLᵀ).

#include <cstdint>
#include <string>

#include <pinocchio/multibody.hpp>
#include <pinocchio/spatial.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics.hpp>

#include <Eigen/Cholesky>

namespace {

constexpr int n = 7;

template <class Scalar>
struct Solver {
  using Model = pinocchio::ModelTpl<Scalar>;
  using Data = pinocchio::DataTpl<Scalar>;
  using SE3 = pinocchio::SE3Tpl<Scalar>;
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;
  using Matrix3 = Eigen::Matrix<Scalar, 3, 3>;
  using Vector6 = Eigen::Matrix<Scalar, 6, 1>;
  using Matrix6 = Eigen::Matrix<Scalar, 6, 6>;
  using Joints = Eigen::Matrix<Scalar, n, 1>;
  using Jacobian = Eigen::Matrix<Scalar, 6, n>;
  using RowMatrix3 = Eigen::Matrix<Scalar, 3, 3, Eigen::RowMajor>;

  Model model;
  Data data;
  SE3 tip;
  Jacobian J;
  Eigen::LLT<Matrix6> factor;

  static SE3 placement(const double *m) {  // 4x4, row by row
    const Eigen::Matrix<double, 4, 4, Eigen::RowMajor> t = Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(m);
    return SE3(t.template topLeftCorner<3, 3>().template cast<Scalar>(), t.template topRightCorner<3, 1>().template cast<Scalar>());
  }

  static Model build(const double *origins) {
    Model model;
    for (int i = 0; i < n; ++i)
      model.addJoint(i, pinocchio::JointModelRevoluteTpl<Scalar, 0, 2>(), placement(origins + 16 * i), "q" + std::to_string(i + 1));
    return model;
  }

  Solver(const double *origins, const double *tip) : model(build(origins)), data(model), tip(placement(tip)) { J.setZero(); }

  static Vector6 error(const SE3 &at, const Vector3 &position, const Matrix3 &rotation) {
    Vector6 e;
    e.template head<3>() = position - at.translation();
    e.template tail<3>() = pinocchio::log3(Matrix3(rotation * at.rotation().transpose()));
    return e;
  }

  // One evaluation of f(q, t) = Jᵀ (J Jᵀ + λ² I)⁻¹ α e, J in the base frame at the tip.
  Joints field(const Joints &q, const Vector3 &position, const Matrix3 &rotation, Scalar alpha, Scalar damping) {
    pinocchio::computeJointJacobians(model, data, q);
    const SE3 at = data.oMi[n] * tip;
    for (int i = 0; i < n; ++i) {  // data.J holds velocities of the point at the base's origin
      const Vector3 spin = data.J.col(i).template tail<3>();
      J.col(i).template head<3>() = data.J.col(i).template head<3>() + spin.cross(at.translation());
      J.col(i).template tail<3>() = spin;
    }
    Matrix6 gram;
    gram.noalias() = J * J.transpose();
    gram.diagonal().array() += damping * damping;
    factor.compute(gram);
    return J.transpose() * factor.solve(alpha * error(at, position, rotation));
  }

  // M < 0: explicit Euler (Drexler 2016, eq. 2); otherwise Crank-Nicolson with M passes (eqs. 6-12).
  void run(Scalar alpha, Scalar damping, Scalar Ts, int N, int M, std::int64_t batch, const Scalar *q0,
           const Scalar *positions, const Scalar *rotations, Scalar *q_end, Scalar *error_end) {
    for (std::int64_t lane = 0; lane < batch; ++lane) {
      Joints q = Eigen::Map<const Joints>(q0 + n * lane);
      const Vector3 position = Eigen::Map<const Vector3>(positions + 3 * lane);
      const Matrix3 rotation = Eigen::Map<const RowMatrix3>(rotations + 9 * lane);
      for (int k = 0; k < N; ++k) {
        const Joints first = field(q, position, rotation, alpha, damping);
        if (M < 0) {
          q += Ts * first;
          continue;
        }
        Joints slope = first;
        for (int i = 0; i < M; ++i) slope = field(q + Ts * slope, position, rotation, alpha, damping);
        q += Ts * (Scalar(0.5) * (first + slope));
      }
      Eigen::Map<Joints>(q_end + n * lane) = q;
      pinocchio::forwardKinematics(model, data, q);
      error_end[lane] = error(data.oMi[n] * tip, position, rotation).norm();
    }
  }
};

}  // namespace

#define CLIK(NAME, SCALAR)                                                                                                \
  extern "C" void *NAME##_new(const double *origins, const double *tip) { return new Solver<SCALAR>(origins, tip); }      \
  extern "C" void NAME##_run(void *solver, double alpha, double damping, double Ts, int N, int M, std::int64_t batch,     \
                             const SCALAR *q0, const SCALAR *positions, const SCALAR *rotations, SCALAR *q, SCALAR *e) {  \
    static_cast<Solver<SCALAR> *>(solver)->run(SCALAR(alpha), SCALAR(damping), SCALAR(Ts), N, M, batch, q0, positions,    \
                                               rotations, q, e);                                                          \
  }                                                                                                                       \
  extern "C" void NAME##_delete(void *solver) { delete static_cast<Solver<SCALAR> *>(solver); }

CLIK(clik_float64, double)
CLIK(clik_float32, float)
