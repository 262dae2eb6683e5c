// DAQP, natively, on the problems that side_by_side.rs wrote.
//
//     daqp FOLDER NAME...
//
// cold: one call that sets up, solves and frees, as its Python package makes. warm: one workspace, updated with all of
// the next problem, starting from the working set of the last. Each with DAQP's settings and with its proximal
// regularisation off, and the warm one also with the early look at the unconstrained minimiser.

#include <cmath>

#include "api.h"
#include "timing.h"
#include "utils.h"

int main(int argc, char** argv) {
    if (argc < 3) return 2;
    for (int argument = 2; argument < argc; ++argument) {
        const std::string name = argv[argument];
        auto data = read_numbers(std::string(argv[1]) + "/" + name + ".f64");
        const auto count = static_cast<std::size_t>(data[0]);
        const int n = static_cast<int>(data[1]), rows = static_cast<int>(data[2]), m = n + rows;
        const int rounds = n < 64 ? 200 : 10;
        std::vector<int> sense(static_cast<std::size_t>(m), 0);
        std::fill(sense.begin() + n, sense.end(), DAQP_SOFT);
        std::vector<DAQPProblem> problems(count);
        std::vector<const double*> expected(count);
        std::vector<std::vector<double>> limits(2 * count);
        std::vector<double> softness(static_cast<std::size_t>(m), 0);
        for (std::size_t k = 0; k < count; ++k) {
            double* h = data.data() + 3 + k * static_cast<std::size_t>(n * (n + 4) + rows * (n + 3));
            double *lower = h + n * n + n, *row = lower + 3 * n, *least = row + rows * n;
            auto& below = limits[2 * k];
            auto& above = limits[2 * k + 1];
            below.assign(lower, lower + n);
            above.assign(lower + n, lower + 2 * n);
            for (int i = 0; i < rows; ++i) {
                below.push_back(std::max(least[i], -DAQP_INF));
                above.push_back(std::min(least[rows + i], DAQP_INF));
                softness[static_cast<std::size_t>(n + i)] = 1 / least[2 * rows + i];  // equal in all problems
            }
            problems[k] = DAQPProblem{};
            problems[k].n = problems[k].ms = n;
            problems[k].m = m;
            problems[k].H = h;
            problems[k].f = h + n * n;
            problems[k].A = rows ? row : nullptr;
            problems[k].blower = below.data();
            problems[k].bupper = above.data();
            problems[k].sense = sense.data();
            expected[k] = lower + 2 * n;
        }
        std::vector<double> x(static_cast<std::size_t>(n)), lam(static_cast<std::size_t>(m));
        double worst = 0;
        int failures = 0;
        auto judge = [&](std::size_t k, const DAQPResult& result) {
            failures += result.exitflag != 1 && result.exitflag != 2;  // 2: some row is exceeded
            for (int i = 0; i < n; ++i) {
                const double range = problems[k].bupper[i] - problems[k].blower[i];
                if (range > 0) worst = std::max(worst, std::abs(x[static_cast<std::size_t>(i)] - expected[k][i]) / range);
            }
        };
        auto result_of = [&] {
            DAQPResult result{};
            result.x = x.data();
            result.lam = lam.data();
            return result;
        };
        for (const bool prox : {true, false}) {
            const std::string how = prox ? ", as it comes" : ", without regularisation";
            DAQPSettings settings;
            daqp_default_settings(&settings);
            if (!prox) settings.eps_prox = 0;
            auto cold = [&](std::size_t k) {
                DAQPResult result = result_of();
                daqp_quadprog(&result, &problems[k], &settings);
                return result;
            };
            if (!rows) {  // its single call takes one weight for all rows
                for (std::size_t k = 0; k < count; ++k) judge(k, cold(k));
                report(name + ", cold" + how, rounds, count, [&] {
                    for (std::size_t k = 0; k < count; ++k) cold(k);
                });
            }
            for (const int look : {0, DAQP_UPDATE_unconstrained}) {
                DAQPWorkspace work{};
                allocate_daqp_settings(&work);
                if (!prox) work.settings->eps_prox = 0;
                DAQPProblem current = problems[0];
                if (setup_daqp(&current, &work, nullptr) < 0) return 1;
                if (rows && !daqp_set_soft_weights(&work, softness.data(), softness.data(), nullptr, nullptr)) return 1;
                const int of_rows = rows ? DAQP_UPDATE_M : 0;
                const int everything =
                    DAQP_UPDATE_Rinv | DAQP_UPDATE_v | DAQP_UPDATE_d | DAQP_UPDATE_sense | of_rows | look;
                auto warm = [&](std::size_t k) {
                    current = problems[k];
                    current.sense = work.sense;  // the working set of the last solve
                    DAQPResult result = result_of();
                    result.exitflag = daqp_update_ldp(everything, &work, &current);
                    if (result.exitflag >= 0) daqp_solve(&result, &work);
                    return result;
                };
                for (std::size_t k = 0; k < count; ++k) judge(k, warm(k));
                report(name + ", warm" + how + (look ? ", looking first" : ""), rounds, count, [&] {
                    for (std::size_t k = 0; k < count; ++k) warm(k);
                });
                free_daqp_workspace(&work);
                free_daqp_ldp(&work);
            }
        }
        std::fprintf(stderr, "%s: %d answers not optimal, largest difference from ours %.1e of the bound range\n",
                     name.c_str(), failures, worst);
    }
}
