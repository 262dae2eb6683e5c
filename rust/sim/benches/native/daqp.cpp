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
        const int n = static_cast<int>(data[1]);
        std::vector<int> sense(static_cast<std::size_t>(n), 0);
        std::vector<DAQPProblem> problems(count);
        std::vector<const double*> expected(count);
        for (std::size_t k = 0; k < count; ++k) {
            double* h = data.data() + 2 + k * static_cast<std::size_t>(n * n + 4 * n);
            problems[k] = DAQPProblem{};
            problems[k].n = problems[k].m = problems[k].ms = n;
            problems[k].H = h;
            problems[k].f = h + n * n;
            problems[k].blower = h + n * n + n;
            problems[k].bupper = h + n * n + 2 * n;
            problems[k].sense = sense.data();
            expected[k] = h + n * n + 3 * n;
        }
        std::vector<double> x(static_cast<std::size_t>(n)), lam(static_cast<std::size_t>(n));
        double worst = 0;
        int failures = 0;
        auto judge = [&](std::size_t k, const DAQPResult& result) {
            failures += result.exitflag != 1;
            for (int i = 0; i < n; ++i) {
                const double range = problems[k].bupper[i] - problems[k].blower[i];
                worst = std::max(worst, std::abs(x[static_cast<std::size_t>(i)] - expected[k][i]) / range);
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
            for (std::size_t k = 0; k < count; ++k) judge(k, cold(k));
            report(name + ", cold" + how, 200, count, [&] {
                for (std::size_t k = 0; k < count; ++k) cold(k);
            });
            for (const int look : {0, DAQP_UPDATE_unconstrained}) {
                DAQPWorkspace work{};
                allocate_daqp_settings(&work);
                if (!prox) work.settings->eps_prox = 0;
                DAQPProblem current = problems[0];
                if (setup_daqp(&current, &work, nullptr) < 0) return 1;
                const int everything = DAQP_UPDATE_Rinv | DAQP_UPDATE_v | DAQP_UPDATE_d | DAQP_UPDATE_sense | look;
                auto warm = [&](std::size_t k) {
                    current = problems[k];
                    current.sense = work.sense;  // the working set of the last solve
                    DAQPResult result = result_of();
                    result.exitflag = daqp_update_ldp(everything, &work, &current);
                    if (result.exitflag >= 0) daqp_solve(&result, &work);
                    return result;
                };
                for (std::size_t k = 0; k < count; ++k) judge(k, warm(k));
                report(name + ", warm" + how + (look ? ", looking first" : ""), 200, count, [&] {
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
