// Loops over samples around Pinocchio's algorithms, compiled from its headers for this very machine.
// A sample's numbers follow one another: q, v, a are samples x joints; matrices come out column by column.
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/regressor.hpp>
#include <pinocchio/algorithm/rnea.hpp>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

namespace pin = pinocchio;
using Vector = Eigen::Map<Eigen::VectorXd>;
using Input = Eigen::Map<const Eigen::VectorXd>;
using Rows = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>;

struct Robot {
    pin::Model model;
    pin::Data data;
    pin::FrameIndex handle;
};

extern "C" Robot *make(int joints, const int *parent, const double *rotation, const double *translation,
                       const double *gravity, const double *mass, const double *com, const double *inertia,
                       int link, const double *point)
{
    pin::Model model;
    model.gravity.linear() = Eigen::Map<const Eigen::Vector3d>(gravity);
    for (int k = 0; k < joints; k++) {
        const pin::SE3 placement(Rows(rotation + 9 * k), Eigen::Map<const Eigen::Vector3d>(translation + 3 * k));
        const auto at = model.addJoint(parent[k] + 1, pin::JointModelRZ(), placement, "joint" + std::to_string(k));
        const pin::Inertia body(mass[k], Eigen::Map<const Eigen::Vector3d>(com + 3 * k), Rows(inertia + 9 * k));
        model.appendBodyToJoint(at, body, pin::SE3::Identity());
    }
    const pin::SE3 at(Eigen::Matrix3d::Identity(), Eigen::Map<const Eigen::Vector3d>(point));
    const auto handle = model.addFrame(pin::Frame("handle", link + 1, 0, at, pin::OP_FRAME));
    return new Robot{model, pin::Data(model), handle};
}

extern "C" void regressor(Robot *r, int samples, const double *q, const double *v, const double *a)
{
    const int n = r->model.nv;
    for (int k = 0; k < samples; k++, q += n, v += n, a += n)
        pin::computeJointTorqueRegressor(r->model, r->data, Input(q, n), Input(v, n), Input(a, n));
}

extern "C" void regressor_stored(Robot *r, int samples, const double *q, const double *v, const double *a, double *out)
{
    const int n = r->model.nv;
    for (int k = 0; k < samples; k++, q += n, v += n, a += n, out += 10 * n * n)
        Eigen::Map<Eigen::MatrixXd>(out, n, 10 * n) =
            pin::computeJointTorqueRegressor(r->model, r->data, Input(q, n), Input(v, n), Input(a, n));
}

extern "C" void inverse(Robot *r, int samples, const double *q, const double *v, const double *a, double *out)
{
    const int n = r->model.nv;
    for (int k = 0; k < samples; k++, q += n, v += n, a += n, out += n)
        Vector(out, n) = pin::rnea(r->model, r->data, Input(q, n), Input(v, n), Input(a, n));
}

extern "C" void mass(Robot *r, int samples, const double *q, double *out)
{
    const int n = r->model.nv;
    for (int k = 0; k < samples; k++, q += n, out += n * n)
        Eigen::Map<Eigen::MatrixXd>(out, n, n) = pin::crba(r->model, r->data, Input(q, n));
}

extern "C" void forward(Robot *r, int samples, const double *q, const double *v, const double *tau, double *out)
{
    const int n = r->model.nv;
    for (int k = 0; k < samples; k++, q += n, v += n, tau += n, out += n)
        Vector(out, n) = pin::aba(r->model, r->data, Input(q, n), Input(v, n), Input(tau, n));
}

/* Torque held; velocity first, then position with the new velocity. */
extern "C" void simulate(Robot *r, int states, int steps, double h, double *q, double *v, const double *tau)
{
    const int n = r->model.nv;
    for (int k = 0; k < states; k++, q += n, v += n, tau += n)
        for (int s = 0; s < steps; s++) {
            Vector(v, n) += h * pin::aba(r->model, r->data, Input(q, n), Input(v, n), Input(tau, n));
            Vector(q, n) += h * Input(v, n);
        }
}

/* Principal masses of a push at the handle, (J A^-1 J')^-1, largest first. */
extern "C" void felt(Robot *r, int poses, const double *q, double *out)
{
    const int n = r->model.nv;
    Eigen::MatrixXd A(n, n);
    pin::Data::Matrix6x J(6, n);
    for (int k = 0; k < poses; k++, q += n, out += 3) {
        A.triangularView<Eigen::Upper>() = pin::crba(r->model, r->data, Input(q, n));
        J.setZero();
        pin::computeFrameJacobian(r->model, r->data, Input(q, n), r->handle, pin::LOCAL_WORLD_ALIGNED, J);
        const Eigen::MatrixXd L = J.topRows<3>();
        const Eigen::Matrix3d mobility = L * A.selfadjointView<Eigen::Upper>().llt().solve(L.transpose());
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> found(mobility, Eigen::EigenvaluesOnly);
        Eigen::Map<Eigen::Vector3d>(out, 3) = found.eigenvalues().cwiseInverse();
    }
}
