// SPDX-License-Identifier: MIT OR Apache-2.0
import QtQuick 2.12
import QtQuick.Controls 2.12
import QtQuick.Layouts 1.12
import Shotcut.Controls 1.0 as Shotcut

// Settings of the filter, for Shotcut with Qt 5 and Qt 6.
Item {
    id: root

    property var defaults: ({
        "motion-file": "",
        "strength": 1,
        "interpolation": "cubic",
        "border-mode": "auto",
        "crop": 0.05,
        "speed": 1
    })
    property var interpolations: ["nearest", "linear", "cubic", "lanczos"]
    property var borders: ["auto", "replicate", "mirror", "constant", "crop"]

    function load() {
        motionFile.text = filter.get("motion-file");
        strength.value = filter.getDouble("strength") * 100;
        interpolation.currentIndex = interpolations.indexOf(filter.get("interpolation"));
        border.currentIndex = borders.indexOf(filter.get("border-mode"));
        crop.value = filter.getDouble("crop") * 100;
        speed.value = filter.getDouble("speed");
    }

    // MLT counts from where the filter begins: the motion file from where the clip does.
    function updateStart() {
        filter.set("start", (filter.in / profile.fps).toFixed(6));
    }

    function openFile() {
        var body = "modality: application.dialogModality; nameFilters: ['" + qsTr("Motion files") + " (*.motion)', '" + qsTr("All files") + " (*)'] }";
        var dialog;
        try {
            dialog = Qt.createQmlObject("import QtQuick.Dialogs 1.3; FileDialog { property bool isQt5: true; " + body, root);
        } catch (error) {
            dialog = Qt.createQmlObject("import QtQuick.Dialogs; FileDialog { property bool isQt5: false; " + body, root);
        }
        dialog.accepted.connect(function() {
            var url = (dialog.isQt5 ? dialog.fileUrl : dialog.selectedFile).toString();
            // On Windows a drive follows the third slash.
            motionFile.text = decodeURIComponent(url).replace(/^file:\/\/(\/(?=[A-Za-z]:))?/, "");
            filter.set("motion-file", motionFile.text);
        });
        dialog.open();
    }

    width: 350
    height: 250
    Component.onCompleted: {
        if (filter.isNew) {
            filter.set("time-unit", "seconds");
            for (var name in defaults)
                filter.set(name, defaults[name]);
        }
        updateStart();
        load();
    }

    Connections {
        target: filter

        function onInChanged() {
            updateStart();
        }
    }

    GridLayout {
        anchors.fill: parent
        anchors.margins: 8
        columns: 3

        Label {
            text: qsTr("Motion file")
            Layout.alignment: Qt.AlignRight
        }

        TextField {
            id: motionFile

            placeholderText: "rsrectify track CLIP --motion FILE"
            selectByMouse: true
            Layout.fillWidth: true
            onEditingFinished: filter.set("motion-file", text)
        }

        Shotcut.Button {
            text: qsTr("Open...")
            onClicked: openFile()
        }

        Label {
            text: qsTr("Strength")
            Layout.alignment: Qt.AlignRight
        }

        Shotcut.SliderSpinner {
            id: strength

            minimumValue: 0
            maximumValue: 100
            suffix: " %"
            onValueChanged: filter.set("strength", value / 100)
        }

        Shotcut.UndoButton {
            onClicked: strength.value = 100
        }

        Label {
            text: qsTr("Interpolation")
            Layout.alignment: Qt.AlignRight
        }

        Shotcut.ComboBox {
            id: interpolation

            model: [qsTr("Nearest"), qsTr("Linear"), qsTr("Cubic"), qsTr("Lanczos")]
            Layout.columnSpan: 2
            onActivated: filter.set("interpolation", interpolations[currentIndex])
        }

        Label {
            text: qsTr("Border")
            Layout.alignment: Qt.AlignRight
        }

        Shotcut.ComboBox {
            id: border

            model: [qsTr("As the motion file says"), qsTr("Repeat the edge"), qsTr("Mirror"), qsTr("Black"), qsTr("Crop")]
            Layout.columnSpan: 2
            onActivated: filter.set("border-mode", borders[currentIndex])
        }

        Label {
            text: qsTr("Crop")
            Layout.alignment: Qt.AlignRight
        }

        Shotcut.SliderSpinner {
            id: crop

            minimumValue: 0
            maximumValue: 50
            suffix: " %"
            onValueChanged: filter.set("crop", value / 100)
        }

        Shotcut.UndoButton {
            onClicked: crop.value = 5
        }

        Label {
            text: qsTr("Speed of the clip")
            Layout.alignment: Qt.AlignRight
        }

        Shotcut.SliderSpinner {
            id: speed

            minimumValue: 0.01
            maximumValue: 100
            decimals: 3
            suffix: " x"
            onValueChanged: filter.set("speed", value)
        }

        Shotcut.UndoButton {
            onClicked: speed.value = 1
        }

        Item {
            Layout.fillHeight: true
            Layout.columnSpan: 3
        }
    }
}
