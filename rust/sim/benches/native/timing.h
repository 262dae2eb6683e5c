// What both native programs share: the files of side_by_side.rs and its way of timing.
#pragma once

#include <algorithm>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

inline std::vector<double> read_numbers(const std::string& path) {
    std::ifstream file(path, std::ios::binary | std::ios::ate);
    if (!file) throw std::runtime_error("cannot read " + path);
    std::vector<double> data(static_cast<std::size_t>(file.tellg()) / sizeof(double));
    file.seekg(0);
    file.read(reinterpret_cast<char*>(data.data()), static_cast<std::streamsize>(data.size() * sizeof(double)));
    return data;
}

inline std::vector<std::string> read_lines(const std::string& path) {
    std::ifstream file(path);
    if (!file) throw std::runtime_error("cannot read " + path);
    std::vector<std::string> lines;
    for (std::string line; std::getline(file, line);) lines.push_back(line);
    return lines;
}

// Processor time of this program [ns]: other programs do not count.
inline double processor_time() {
    std::timespec now{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return 1e9 * static_cast<double>(now.tv_sec) + static_cast<double>(now.tv_nsec);
}

// Times `rounds` rounds of `count` states or problems each, after one to warm up; prints median and minimum.
template <class Round>
void report(const std::string& what, int rounds, std::size_t count, Round round) {
    round();
    std::vector<double> times;
    for (int i = 0; i < rounds; ++i) {
        const double begin = processor_time();
        round();
        times.push_back((processor_time() - begin) / static_cast<double>(count));
    }
    std::sort(times.begin(), times.end());
    std::printf("%s\t%.1f\t%.1f\n", what.c_str(), times[times.size() / 2], times.front());
}
