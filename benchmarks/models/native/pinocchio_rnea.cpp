// CPU nanoseconds of a call of pinocchio::rnea, and the sum of all torques:
// pinocchio_rnea ARM_FILE JOINTS STATES_FILE COUNT ROUNDS. The arm's file holds, for each joint as doubles: its parent
// (0 the base), rotation (9, row by row), translation (3), mass, centre of mass (3), inertia about it (9); all joints
// turn about z. The states' file holds COUNT times q, dq, ddq.
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <string>
#include <vector>

#include <pinocchio/multibody.hpp>

#include <pinocchio/algorithm/rnea.hpp>

static std::vector<double> numbers(const char *path, std::size_t count)
{
    std::vector<double> values(count);
    std::FILE *file = std::fopen(path, "rb");
    if (file == nullptr || std::fread(values.data(), sizeof(double), count, file) != count) {
        std::exit(2);
    }
    std::fclose(file);
    return values;
}

int main(int argc, char **argv)
{
    if (argc != 6) {
        return 2;
    }
    using Matrix = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    const std::size_t joints = std::atol(argv[2]), count = std::atol(argv[4]);
    const long rounds = std::atol(argv[5]);
    const std::vector<double> arm = numbers(argv[1], 26 * joints), all = numbers(argv[3], 3 * joints * count);
    pinocchio::Model model;
    for (std::size_t joint = 0; joint < joints; joint++) {
        const double *row = arm.data() + 26 * joint;
        const pinocchio::SE3 placement(Eigen::Map<const Matrix>(row + 1), Eigen::Map<const Eigen::Vector3d>(row + 10));
        const auto index = model.addJoint(static_cast<pinocchio::JointIndex>(row[0]), pinocchio::JointModelRZ(),
                                          placement, "joint" + std::to_string(joint));
        model.inertias[index] = pinocchio::Inertia(row[13], Eigen::Map<const Eigen::Vector3d>(row + 14),
                                                   Eigen::Map<const Matrix>(row + 17));
    }
    pinocchio::Data data(model);
    std::vector<Eigen::VectorXd> states;
    for (std::size_t i = 0; i < 3 * count; i++) {
        states.push_back(Eigen::Map<const Eigen::VectorXd>(all.data() + i * joints, joints));
    }
    double sum = 0.0;
    const std::clock_t start = std::clock();
    for (long round = 0; round < rounds; round++) {
        for (std::size_t i = 0; i < count; i++) {
            sum += pinocchio::rnea(model, data, states[3 * i], states[3 * i + 1], states[3 * i + 2]).sum();
        }
    }
    const double seconds = double(std::clock() - start) / CLOCKS_PER_SEC;
    std::printf("%.17g %.17g\n", 1e9 * seconds / (double(rounds) * double(count)), sum / double(rounds));
    return 0;
}
