// SPDX-License-Identifier: MIT OR Apache-2.0

// The same job composed of OpenCV parts, for comparison; `scripts/compare-speed` builds and runs it.
//
// Usage: opencv_job VIDEO.y4m THREADS     (8-bit 4:2:0)
//
// For each frame: luma reduced to 960 columns, pyramidal Lucas-Kanade on a 32 x 24 grid, a similarity by RANSAC, a map
// whose angle and shift grow with the row, cubic remap of the three planes. Prints the median time of a frame in
// milliseconds, reading left out.

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

namespace {

using Planes = std::array<cv::Mat, 3>;

/// Frames of an 8-bit 4:2:0 Y4M file.
class Video {
public:
    explicit Video(const std::string& path) : file_(path, std::ios::binary) {
        std::string header, field;
        if (!std::getline(file_, header)) throw std::runtime_error("cannot read " + path);
        for (std::istringstream fields(header); fields >> field;) {
            if (field[0] == 'W') size_.width = std::stoi(field.substr(1));
            if (field[0] == 'H') size_.height = std::stoi(field.substr(1));
        }
    }

    bool read(Planes& planes) {
        std::string line;
        if (!std::getline(file_, line)) return false;
        const cv::Size chroma((size_.width + 1) / 2, (size_.height + 1) / 2);
        for (std::size_t index = 0; index < planes.size(); ++index) {
            planes[index].create(index == 0 ? size_ : chroma, CV_8U);
            file_.read(planes[index].ptr<char>(), static_cast<std::streamsize>(planes[index].total()));
        }
        return static_cast<bool>(file_);
    }

private:
    std::ifstream file_;
    cv::Size size_;
};

/// Where each output pixel of a plane is found.
struct RowMaps {
    cv::Mat x, y;

    /// For a motion of `turn` radians and `shift` pixels of the plane a frame: a line a row.
    void fill(cv::Size size, double turn, cv::Point2d shift) {
        x.create(size, CV_32F);
        y.create(size, CV_32F);
        const cv::Point2d centre((size.width - 1) / 2.0, (size.height - 1) / 2.0);
        cv::parallel_for_(cv::Range(0, size.height), [&](const cv::Range& rows) {
            for (int row = rows.start; row < rows.end; ++row) {
                const double from_centre = row - centre.y, share = from_centre / size.height;
                const auto cosine = static_cast<float>(std::cos(turn * share));
                const auto sine = static_cast<float>(std::sin(turn * share));
                const auto left = static_cast<float>(-centre.x);
                const auto start_x = static_cast<float>(-sine * from_centre + shift.x * share + centre.x);
                const auto start_y = static_cast<float>(cosine * from_centre + shift.y * share + centre.y);
                float* to_x = x.ptr<float>(row);
                float* to_y = y.ptr<float>(row);
                for (int column = 0; column < size.width; ++column) {
                    to_x[column] = cosine * (left + static_cast<float>(column)) + start_x;
                    to_y[column] = sine * (left + static_cast<float>(column)) + start_y;
                }
            }
        });
    }
};

/// A stream that is being rectified; keeps its buffers.
class Job {
public:
    /// Rectifies a frame by the similarity between it and the one before it, where there is one.
    void frame(const Planes& planes) {
        const double reduction = std::max(1.0, planes[0].cols / 960.0);
        const cv::Size size(cvRound(planes[0].cols / reduction), cvRound(planes[0].rows / reduction));
        cv::resize(planes[0], now_, size, 0, 0, cv::INTER_AREA);
        if (before_.empty()) {
            for (int row = 0; row < 24; ++row)
                for (int column = 0; column < 32; ++column)
                    grid_.emplace_back((column + 0.5F) * size.width / 32, (row + 0.5F) * size.height / 24);
        } else {
            rectify(planes, reduction);
        }
        cv::swap(before_, now_);
    }

private:
    void rectify(const Planes& planes, double reduction) {
        cv::calcOpticalFlowPyrLK(before_, now_, grid_, moved_, status_, cv::noArray(), cv::Size(15, 15), 4);
        from_.clear();
        to_.clear();
        for (std::size_t index = 0; index < grid_.size(); ++index) {
            if (!status_[index]) continue;
            from_.push_back(grid_[index]);
            to_.push_back(moved_[index]);
        }
        const cv::Mat model = cv::estimateAffinePartial2D(from_, to_, cv::noArray(), cv::RANSAC, 1.5);
        if (model.empty()) return;
        const cv::Matx23d m = model;
        const double turn = std::atan2(m(1, 0), m(0, 0));
        const cv::Point2d centre(before_.cols / 2.0, before_.rows / 2.0);
        const cv::Point2d centre_moved(m * cv::Vec3d(centre.x, centre.y, 1.0));
        const cv::Point2d shift = (centre_moved - centre) * reduction;
        maps_[0].fill(planes[0].size(), turn, shift);
        maps_[1].fill(planes[1].size(), turn, shift / 2);
        for (std::size_t index = 0; index < planes.size(); ++index) {
            const RowMaps& map = maps_[std::min<std::size_t>(index, 1)];
            cv::remap(planes[index], rectified_[index], map.x, map.y, cv::INTER_CUBIC, cv::BORDER_REPLICATE);
        }
    }

    cv::Mat before_, now_;
    std::vector<cv::Point2f> grid_, moved_, from_, to_;
    std::vector<unsigned char> status_;
    std::array<RowMaps, 2> maps_;
    Planes rectified_;
};

}  // namespace

int main(int count, char** arguments) try {
    if (count != 3) {
        std::cerr << "usage: opencv_job VIDEO.y4m THREADS\n";
        return 2;
    }
    cv::setNumThreads(std::atoi(arguments[2]));
    Video video(arguments[1]);
    Planes planes;
    Job job;
    std::vector<double> times;
    while (video.read(planes)) {
        const auto started = std::chrono::steady_clock::now();
        job.frame(planes);
        times.push_back(std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - started).count());
    }
    // The first frame has nothing to be compared with.
    if (times.size() < 2) throw std::runtime_error("too few frames");
    times.erase(times.begin());
    std::sort(times.begin(), times.end());
    std::cout << times[times.size() / 2] << '\n';
    return 0;
} catch (const std::exception& error) {
    std::cerr << error.what() << '\n';
    return 1;
}
