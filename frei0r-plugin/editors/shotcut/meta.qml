// SPDX-License-Identifier: MIT OR Apache-2.0
import QtQuick 2.0
import org.shotcut.qml 1.0

Metadata {
    type: Metadata.Filter
    name: qsTr("Rolling Shutter Rectifier")
    keywords: qsTr('jello wobble lean shear skew') + ' rolling shutter rectifier rsrectify frei0r.rsrectify'
    mlt_service: "frei0r.rsrectify"
    objectName: "rsrectify"
    qml: "ui.qml"
}
