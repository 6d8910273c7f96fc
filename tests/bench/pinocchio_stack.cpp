// A weighted damped step of a stack of poses on a tree, with Pinocchio and Eigen: q̇ = (JᵀW²J + λ²)⁻¹ JᵀW²(alpha e); of
// positions where the weight of orientations is 0.
// The tree is given as arrays, so that no file is parsed: of each joint its parent, kind and placement. Kinds: 0, 1, 2
// turn about x, y, z; 3, 4, 5 slide along them; 6 is a ball joint, whose value is a quaternion x, y, z, w.

#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/joint-configuration.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <ctime>
#include <string>
#include <vector>

using namespace pinocchio;

static SE3 placed(const double *m) {
  Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>> map(m);
  return SE3(Eigen::Matrix3d(map.topLeftCorner<3, 3>()), Eigen::Vector3d(map.topRightCorner<3, 1>()));
}

struct Stack {
  Model model;
  Data data;
  std::vector<FrameIndex> tips;
  Eigen::MatrixXd J, own, H;
  Eigen::VectorXd e, x, moved;
  Eigen::LLT<Eigen::MatrixXd> llt;

  Stack(int joints, const int *parents, const int *kinds, const double *places, int count, const int *carriers,
        const double *offsets) {
    for (int i = 0; i < joints; ++i) {
      const std::string name = "joint" + std::to_string(i);
      const JointIndex parent = parents[i] + 1;
      const SE3 at = placed(places + 16 * i);
      switch (kinds[i]) {
        case 0: model.addJoint(parent, JointModelRX(), at, name); break;
        case 1: model.addJoint(parent, JointModelRY(), at, name); break;
        case 2: model.addJoint(parent, JointModelRZ(), at, name); break;
        case 3: model.addJoint(parent, JointModelPX(), at, name); break;
        case 4: model.addJoint(parent, JointModelPY(), at, name); break;
        case 5: model.addJoint(parent, JointModelPZ(), at, name); break;
        default: model.addJoint(parent, JointModelSpherical(), at, name);
      }
    }
    for (int k = 0; k < count; ++k)
      tips.push_back(model.addFrame(
          Frame("tip" + std::to_string(k), carriers[k] + 1, 0, placed(offsets + 16 * k), OP_FRAME)));
    data = Data(model);
    own.resize(6, model.nv), H.resize(model.nv, model.nv), x.resize(model.nv), moved.resize(model.nq);
  }

  void step(double *q, const double *targets, double alpha, double damping, const double *weights, double Ts) {
    Eigen::Map<Eigen::VectorXd> at(q, model.nq);
    computeJointJacobians(model, data, at);
    updateFramePlacements(model, data);
    const Eigen::Index rows = weights[1] > 0 ? 6 : 3;
    J.resize(rows * tips.size(), model.nv), e.resize(rows * tips.size());
    for (std::size_t k = 0; k < tips.size(); ++k) {
      own.setZero();
      getFrameJacobian(model, data, tips[k], LOCAL_WORLD_ALIGNED, own);
      const SE3 goal = placed(targets + 16 * k), &tip = data.oMf[tips[k]];
      J.block(rows * k, 0, 3, model.nv) = weights[0] * own.topRows(3);
      e.segment<3>(rows * k) = alpha * weights[0] * (goal.translation() - tip.translation());
      if (rows == 3) continue;
      J.block(rows * k + 3, 0, 3, model.nv) = weights[1] * own.bottomRows(3);
      e.segment<3>(rows * k + 3) = alpha * weights[1] * log3(Eigen::Matrix3d(goal.rotation() * tip.rotation().transpose()));
    }
    H.setZero();
    H.selfadjointView<Eigen::Lower>().rankUpdate(J.transpose());
    H.diagonal().array() += damping * damping;
    llt.compute(H);
    x.noalias() = J.transpose() * e;
    llt.solveInPlace(x);
    x *= Ts;
    integrate(model, at, x, moved);
    at = moved;
  }
};

extern "C" {
void *stack_new(int joints, const int *parents, const int *kinds, const double *places, int count, const int *carriers,
                const double *offsets) {
  return new Stack(joints, parents, kinds, places, count, carriers, offsets);
}
void stack_delete(void *stack) { delete static_cast<Stack *>(stack); }

// N steps of each of `batch` loops from q (batch, nq), in place; targets (batch, tips, 4, 4). CPU seconds.
double stack_run(void *stack, int batch, int N, double *q, const double *targets, double alpha, double damping,
                 const double *weights, double Ts) {
  Stack &own = *static_cast<Stack *>(stack);
  timespec a, b;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &a);
  for (int i = 0; i < batch; ++i)
    for (int k = 0; k < N; ++k)
      own.step(q + std::size_t(i) * own.model.nq, targets + std::size_t(i) * 16 * own.tips.size(), alpha, damping,
               weights, Ts);
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &b);
  return (b.tv_sec - a.tv_sec) + 1e-9 * (b.tv_nsec - a.tv_nsec);
}
}
