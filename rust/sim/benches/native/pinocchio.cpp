// The dynamics of a tick in Pinocchio, natively, on the states that side_by_side.rs wrote.
//
//     pinocchio FOLDER
//
// FOLDER also holds model.bin, the robot as `pin.Model.saveToBinary` writes it: the wheel lacks the headers that its
// URDF parser needs.
// Twice: as separate calls, and with computeAllTerms, which shares work between them. Both must come to the same
// numbers as ours: the squared norms of M, A_G and the Jacobians do not depend on the convention of velocities.

#include <cmath>
#include <cstdlib>

#include <pinocchio/algorithm/center-of-mass.hpp>
#include <pinocchio/algorithm/centroidal.hpp>
#include <pinocchio/algorithm/compute-all-terms.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/serialization.hpp>

#include "timing.h"

namespace pin = pinocchio;

struct Bundle {
    const pin::Model& model;
    pin::Data data;
    std::vector<pin::FrameIndex> frames;
    std::vector<pin::Data::Matrix6x> jacobians;

    Bundle(const pin::Model& model, const std::vector<std::string>& names) : model(model), data(model) {
        for (const auto& name : names) frames.push_back(model.getFrameId(name, pin::BODY));
        jacobians.assign(frames.size(), pin::Data::Matrix6x::Zero(6, model.nv));
    }

    // Poses, centre of mass, M, h, A_G with L and I_G; joint Jacobians as far as these need them.
    void separate(const Eigen::VectorXd& q, const Eigen::VectorXd& v) {
        pin::crba(model, data, q, pin::Convention::WORLD);
        pin::nonLinearEffects(model, data, q, v);
        pin::ccrba(model, data, q, v);
    }

    void together(const Eigen::VectorXd& q, const Eigen::VectorXd& v) { pin::computeAllTerms(model, data, q, v); }

    void frame_jacobians() {
        pin::updateFramePlacements(model, data);
        for (std::size_t i = 0; i < frames.size(); ++i) {
            // Columns that are zero for this frame stay zero.
            pin::getFrameJacobian(model, data, frames[i], pin::LOCAL_WORLD_ALIGNED, jacobians[i]);
        }
    }

    void check(const double* expected) {
        data.M.triangularView<Eigen::StrictlyLower>() = data.M.transpose().triangularView<Eigen::StrictlyLower>();
        double sum = 0;
        for (const auto& jacobian : jacobians) sum += jacobian.squaredNorm();
        const double ours[3] = {data.M.squaredNorm(), data.Ag.squaredNorm(), sum};
        for (int i = 0; i < 3; ++i) {
            if (!(std::abs(ours[i] - expected[i]) <= 1e-10 * expected[i])) {
                std::fprintf(stderr, "term %d comes to %.15g, expected %.15g\n", i, ours[i], expected[i]);
                std::exit(1);
            }
        }
    }
};

int main(int argc, char** argv) {
    if (argc != 2) return 2;
    const std::string folder = std::string(argv[1]) + "/";
    pin::Model model;
    model.loadFromBinary(folder + "model.bin");

    const auto joints = read_lines(folder + "joints.txt");
    const auto data = read_numbers(folder + "states.f64");
    const auto check = read_numbers(folder + "check.f64");
    const auto count = static_cast<std::size_t>(data[0]), n = static_cast<std::size_t>(data[1]);
    std::vector<Eigen::VectorXd> q(count, Eigen::VectorXd(model.nq)), v(count, Eigen::VectorXd(model.nv));
    for (std::size_t k = 0; k < count; ++k) {
        const double* row = data.data() + 2 + k * (12 + n + 6 + n);
        const Eigen::Matrix3d rotation = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(row + 3);
        const double *position = row + 12, *velocity = row + 12 + n;
        q[k].head<3>() = Eigen::Map<const Eigen::Vector3d>(row);
        q[k].segment<4>(3) = Eigen::Quaterniond(rotation).coeffs();
        v[k].head<3>() = rotation.transpose() * Eigen::Map<const Eigen::Vector3d>(velocity);
        v[k].segment<3>(3) = rotation.transpose() * Eigen::Map<const Eigen::Vector3d>(velocity + 3);
        for (std::size_t i = 0; i < n; ++i) {
            const auto joint = model.getJointId(joints[i]);
            q[k][model.joints[joint].idx_q()] = position[i];
            v[k][model.joints[joint].idx_v()] = velocity[6 + i];
        }
    }

    Bundle bundle(model, read_lines(folder + "frames.txt"));
    for (const bool together : {false, true}) {
        auto terms = [&](std::size_t k) { together ? bundle.together(q[k], v[k]) : bundle.separate(q[k], v[k]); };
        for (std::size_t k = 0; k < count; ++k) {
            terms(k);
            bundle.frame_jacobians();
            bundle.check(check.data() + 3 * k);
        }
        const std::string how = together ? ", computeAllTerms" : ", separate calls";
        report("dynamics, without Jacobians" + how, 300, count, [&] {
            for (std::size_t k = 0; k < count; ++k) terms(k);
        });
        report("dynamics, with 17 frame Jacobians" + how, 300, count, [&] {
            for (std::size_t k = 0; k < count; ++k) {
                terms(k);
                bundle.frame_jacobians();
            }
        });
    }
}
